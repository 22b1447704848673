impl :: bincode :: Encode for Index
{
    fn encode < __E : :: bincode :: enc :: Encoder >
    (& self, encoder : & mut __E) ->core :: result :: Result < (), :: bincode
    :: error :: EncodeError >
    {
        :: bincode :: Encode :: encode(&self.session_id, encoder) ?; ::
        bincode :: Encode :: encode(&self.segments, encoder) ?; :: bincode ::
        Encode :: encode(&self.cameras, encoder) ?; :: bincode :: Encode ::
        encode(&self.imus, encoder) ?; :: bincode :: Encode ::
        encode(&self.sets, encoder) ?; :: bincode :: Encode ::
        encode(&self.damaged, encoder) ?; core :: result :: Result :: Ok(())
    }
}