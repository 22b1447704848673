impl < __Context > :: bincode :: Decode < __Context > for FrameEntry
{
    fn decode < __D : :: bincode :: de :: Decoder < Context = __Context > >
    (decoder : & mut __D) ->core :: result :: Result < Self, :: bincode ::
    error :: DecodeError >
    {
        core :: result :: Result ::
        Ok(Self
        {
            number : :: bincode :: Decode :: decode(decoder) ?, time_ns : ::
            bincode :: Decode :: decode(decoder) ?, sigma_ns : :: bincode ::
            Decode :: decode(decoder) ?, time_doubtful : :: bincode :: Decode
            :: decode(decoder) ?, host_time_ns : :: bincode :: Decode ::
            decode(decoder) ?, device_ticks : :: bincode :: Decode ::
            decode(decoder) ?, key : :: bincode :: Decode :: decode(decoder)
            ?, segment : :: bincode :: Decode :: decode(decoder) ?, offset :
            :: bincode :: Decode :: decode(decoder) ?, bytes : :: bincode ::
            Decode :: decode(decoder) ?, crc32 : :: bincode :: Decode ::
            decode(decoder) ?,
        })
    }
} impl < '__de, __Context > :: bincode :: BorrowDecode < '__de, __Context >
for FrameEntry
{
    fn borrow_decode < __D : :: bincode :: de :: BorrowDecoder < '__de,
    Context = __Context > > (decoder : & mut __D) ->core :: result :: Result <
    Self, :: bincode :: error :: DecodeError >
    {
        core :: result :: Result ::
        Ok(Self
        {
            number : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, time_ns : :: bincode :: BorrowDecode ::<
            '_, __Context >:: borrow_decode(decoder) ?, sigma_ns : :: bincode
            :: BorrowDecode ::< '_, __Context >:: borrow_decode(decoder) ?,
            time_doubtful : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, host_time_ns : :: bincode ::
            BorrowDecode ::< '_, __Context >:: borrow_decode(decoder) ?,
            device_ticks : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, key : :: bincode :: BorrowDecode ::< '_,
            __Context >:: borrow_decode(decoder) ?, segment : :: bincode ::
            BorrowDecode ::< '_, __Context >:: borrow_decode(decoder) ?,
            offset : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, bytes : :: bincode :: BorrowDecode ::<
            '_, __Context >:: borrow_decode(decoder) ?, crc32 : :: bincode ::
            BorrowDecode ::< '_, __Context >:: borrow_decode(decoder) ?,
        })
    }
}