//! Which compressed formats exist here, and what each is called elsewhere.

use std::fmt;

/// A compressed video format: always Annex B byte stream, one access unit at a time, no B-frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Codec {
    /// ITU-T H.264 (AVC).
    H264,
    /// ITU-T H.265 (HEVC).
    H265,
}

impl Codec {
    /// The `format` string of a `foxglove.CompressedVideo` message: `"h264"` or `"h265"`.
    pub fn foxglove_format(self) -> &'static str {
        match self {
            Codec::H264 => "h264",
            Codec::H265 => "h265",
        }
    }

    /// The codec that a `foxglove.CompressedVideo` format string names, if it is one of ours.
    pub fn from_foxglove_format(format: &str) -> Option<Codec> {
        match format {
            "h264" => Some(Codec::H264),
            "h265" => Some(Codec::H265),
            _ => None,
        }
    }

    /// GStreamer's media type.
    pub(crate) fn media_type(self) -> &'static str {
        match self {
            Codec::H264 => "video/x-h264",
            Codec::H265 => "video/x-h265",
        }
    }

    /// GStreamer's parser element.
    pub(crate) fn parser(self) -> &'static str {
        match self {
            Codec::H264 => "h264parse",
            Codec::H265 => "h265parse",
        }
    }
}

impl fmt::Display for Codec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Codec::H264 => "H.264",
            Codec::H265 => "H.265",
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn format_strings_come_back() {
        for codec in [Codec::H264, Codec::H265] {
            assert_eq!(
                Codec::from_foxglove_format(codec.foxglove_format()),
                Some(codec)
            );
        }
        assert_eq!(Codec::from_foxglove_format("av1"), None);
        assert_eq!(Codec::from_foxglove_format("H264"), None);
    }
}
