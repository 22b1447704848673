impl < __Context > :: bincode :: Decode < __Context > for Index
{
    fn decode < __D : :: bincode :: de :: Decoder < Context = __Context > >
    (decoder : & mut __D) ->core :: result :: Result < Self, :: bincode ::
    error :: DecodeError >
    {
        core :: result :: Result ::
        Ok(Self
        {
            session_id : :: bincode :: Decode :: decode(decoder) ?, segments :
            :: bincode :: Decode :: decode(decoder) ?, cameras : :: bincode ::
            Decode :: decode(decoder) ?, imus : :: bincode :: Decode ::
            decode(decoder) ?, sets : :: bincode :: Decode :: decode(decoder)
            ?, damaged : :: bincode :: Decode :: decode(decoder) ?,
        })
    }
} impl < '__de, __Context > :: bincode :: BorrowDecode < '__de, __Context >
for Index
{
    fn borrow_decode < __D : :: bincode :: de :: BorrowDecoder < '__de,
    Context = __Context > > (decoder : & mut __D) ->core :: result :: Result <
    Self, :: bincode :: error :: DecodeError >
    {
        core :: result :: Result ::
        Ok(Self
        {
            session_id : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, segments : :: bincode :: BorrowDecode
            ::< '_, __Context >:: borrow_decode(decoder) ?, cameras : ::
            bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?, imus : :: bincode :: BorrowDecode ::<
            '_, __Context >:: borrow_decode(decoder) ?, sets : :: bincode ::
            BorrowDecode ::< '_, __Context >:: borrow_decode(decoder) ?,
            damaged : :: bincode :: BorrowDecode ::< '_, __Context >::
            borrow_decode(decoder) ?,
        })
    }
}