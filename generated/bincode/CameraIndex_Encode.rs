impl :: bincode :: Encode for CameraIndex
{
    fn encode < __E : :: bincode :: enc :: Encoder >
    (& self, encoder : & mut __E) ->core :: result :: Result < (), :: bincode
    :: error :: EncodeError >
    {
        :: bincode :: Encode :: encode(&self.name, encoder) ?; :: bincode ::
        Encode :: encode(&self.frames, encoder) ?; :: bincode :: Encode ::
        encode(&self.undecodable, encoder) ?; core :: result :: Result ::
        Ok(())
    }
}