impl :: bincode :: Encode for BatchEntry
{
    fn encode < __E : :: bincode :: enc :: Encoder >
    (& self, encoder : & mut __E) ->core :: result :: Result < (), :: bincode
    :: error :: EncodeError >
    {
        :: bincode :: Encode :: encode(&self.first_number, encoder) ?; ::
        bincode :: Encode :: encode(&self.samples, encoder) ?; :: bincode ::
        Encode :: encode(&self.start_ns, encoder) ?; :: bincode :: Encode ::
        encode(&self.end_ns, encoder) ?; :: bincode :: Encode ::
        encode(&self.segment, encoder) ?; :: bincode :: Encode ::
        encode(&self.offset, encoder) ?; :: bincode :: Encode ::
        encode(&self.bytes, encoder) ?; :: bincode :: Encode ::
        encode(&self.crc32, encoder) ?; core :: result :: Result :: Ok(())
    }
}