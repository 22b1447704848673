impl :: bincode :: Encode for SetEntry
{
    fn encode < __E : :: bincode :: enc :: Encoder >
    (& self, encoder : & mut __E) ->core :: result :: Result < (), :: bincode
    :: error :: EncodeError >
    {
        :: bincode :: Encode :: encode(&self.number, encoder) ?; :: bincode ::
        Encode :: encode(&self.time_ns, encoder) ?; :: bincode :: Encode ::
        encode(&self.frames, encoder) ?; core :: result :: Result :: Ok(())
    }
}