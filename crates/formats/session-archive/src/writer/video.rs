//! `foxglove.CompressedVideo`, encoded without a copy of the access unit in between.

/// `foxglove.CompressedVideo` with borrowed data, so that an access unit is copied once, straight
/// into the chunk. A test holds it to the generated type.
pub(super) struct VideoRef<'a> {
    pub(super) timestamp: prost_types::Timestamp,
    pub(super) frame_id: String,
    pub(super) data: &'a [u8],
    pub(super) format: &'a str,
}

impl VideoRef<'_> {
    /// Appends the message.
    pub(super) fn encode(&self, out: &mut Vec<u8>) {
        use prost::encoding::{WireType, encode_key, encode_varint, message, string};
        out.reserve(self.data.len() + 64);
        message::encode(1, &self.timestamp, out);
        if !self.frame_id.is_empty() {
            string::encode(2, &self.frame_id, out);
        }
        if !self.data.is_empty() {
            encode_key(3, WireType::LengthDelimited, out);
            encode_varint(self.data.len() as u64, out);
            out.extend_from_slice(self.data);
        }
        if !self.format.is_empty() {
            encode_key(4, WireType::LengthDelimited, out);
            encode_varint(self.format.len() as u64, out);
            out.extend_from_slice(self.format.as_bytes());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::{CompressedVideo, Protobuf, timestamp};
    use crate::time::HostTime;

    /// Reference implementation: the generated type, which owns its data.
    #[test]
    fn encodes_as_the_generated_type_does() {
        let datas: [&[u8]; 4] = [&[], &[7], &[0; 127], &[0xAB; 70_000]];
        for data in datas {
            for (time, frame_id, format) in [
                (0, "", ""),
                (1_999_999_999, "feet/left", "h264"),
                (-1, "left_shoulder/left", "h265"),
                (i64::MAX, "x", ""),
            ] {
                let time = timestamp(HostTime(time));
                let mut ours = b"before".to_vec();
                let message = VideoRef {
                    timestamp: time,
                    frame_id: frame_id.to_owned(),
                    data,
                    format,
                };
                message.encode(&mut ours);
                let twin = CompressedVideo {
                    timestamp: Some(time),
                    frame_id: frame_id.to_owned(),
                    data: data.to_vec().into(),
                    format: format.to_owned(),
                };
                assert_eq!(ours[6..], twin.encode_to_vec());
            }
        }
    }
}
