impl < __Context > :: bincode :: Decode < __Context > for BatchEntry
{
    fn decode < __D : :: bincode :: de :: Decoder < Context = __Context > >
    (decoder : & mut __D) ->core :: result :: Result < Self, :: bincode ::
    error :: DecodeError >
    {
        core :: result :: Result ::
        Ok(Self
        {
            first_number : :: bincode :: Decode :: decode(decoder) ?, samples
            : :: bincode :: Decode :: decode(decoder) ?, start_ns : :: bincode
            :: Decode :: decode(decoder) ?, end_ns : :: bincode :: Decode ::
            decode(decoder) ?, segment : :: bincode :: Decode ::
            decode(decoder) ?, offset : :: bincode :: Decode ::
            decode(decoder) ?, bytes : :: bincode :: Decode :: decode(decoder)
            ?, crc32 : :: bincode :: Decode :: decode(decoder) ?,
        })
    }
} impl < '__de, __Context > :: bincode :: BorrowDecode < '__de, __Context >
for BatchEntry
{
    fn borrow_decode < __D : :: bincode :: de :: BorrowDecoder < '__de,
    Context = __Context > > (decoder : & mut __D) ->core :: result :: Result <
    Self, :: bincode :: error :: DecodeError >
    {
        core :: result :: Result ::
        Ok(Self
        {
            first_number : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, samples : :: bincode :: BorrowDecode ::<
            '_, __Context >:: borrow_decode(decoder) ?, start_ns : :: bincode
            :: BorrowDecode ::< '_, __Context >:: borrow_decode(decoder) ?,
            end_ns : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, segment : :: bincode :: BorrowDecode ::<
            '_, __Context >:: borrow_decode(decoder) ?, offset : :: bincode ::
            BorrowDecode ::< '_, __Context >:: borrow_decode(decoder) ?, bytes
            : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, crc32 : :: bincode :: BorrowDecode ::<
            '_, __Context >:: borrow_decode(decoder) ?,
        })
    }
}