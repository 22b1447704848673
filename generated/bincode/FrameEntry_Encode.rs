impl :: bincode :: Encode for FrameEntry
{
    fn encode < __E : :: bincode :: enc :: Encoder >
    (& self, encoder : & mut __E) ->core :: result :: Result < (), :: bincode
    :: error :: EncodeError >
    {
        :: bincode :: Encode :: encode(&self.number, encoder) ?; :: bincode ::
        Encode :: encode(&self.time_ns, encoder) ?; :: bincode :: Encode ::
        encode(&self.sigma_ns, encoder) ?; :: bincode :: Encode ::
        encode(&self.time_doubtful, encoder) ?; :: bincode :: Encode ::
        encode(&self.host_time_ns, encoder) ?; :: bincode :: Encode ::
        encode(&self.device_ticks, encoder) ?; :: bincode :: Encode ::
        encode(&self.key, encoder) ?; :: bincode :: Encode ::
        encode(&self.segment, encoder) ?; :: bincode :: Encode ::
        encode(&self.offset, encoder) ?; :: bincode :: Encode ::
        encode(&self.bytes, encoder) ?; :: bincode :: Encode ::
        encode(&self.crc32, encoder) ?; core :: result :: Result :: Ok(())
    }
}