//! The encoders we know how to drive, as data: one row each, best first.
//!
//! Every row requests the same behaviour through its element's own properties: one quantiser for
//! all frames, no B-frames, no key frame that was not requested, closed groups of frames, one
//! access unit out per frame in, full-range video. Where an element has several properties for one
//! thing, the units differ (`nvv4l2` counts bit/s, the others kbit/s), which is one reason why no
//! bit rate is set anywhere.
//!
//! Read where: the elements' own property lists for x264enc, x265enc and openh264enc (GStreamer
//! 1.22, run here); NVIDIA's published source and property list of the nvv4l2 elements (Jetson
//! r36); gstreamer.freedesktop.org for the nvcodec, va and qsv plugins. **The hardware rows have
//! never been run by this project**: a trial encode decides on the machine itself whether they
//! keep the promise.

use crate::Codec;

/// In which memory and layout an encoder wants its frames.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Input {
    /// I420 in system memory: as they are.
    I420,
    /// NV12 in system memory: through `videoconvert`.
    Nv12,
    /// NV12 in the Jetson's device memory: through `nvvidconv`.
    NvmmNv12,
}

/// How a key frame is requested.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Force {
    /// GStreamer's force-key-unit event, which names the frame by its time.
    Event,
    /// An action signal of the element. It acts on whatever is encoded next, so it is sent when
    /// the frame is about to enter the encoder and everything before it has come out.
    Signal(&'static str),
}

/// Whether the row still holds without a property.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Need {
    /// An element without it is refused.
    Must,
    /// Exists in some versions only, or only improves on the default.
    Try,
}

/// One property: the first of `names` that the element has gets `value`, in which `{qp}`, `{gop}`,
/// `{threads}`, `{pools}`, `{preset}` and `{sliced}` are replaced.
#[derive(Debug)]
pub(crate) struct Property {
    pub(crate) names: &'static [&'static str],
    pub(crate) value: &'static str,
    pub(crate) need: Need,
}

/// One row of the table.
#[derive(Debug)]
pub(crate) struct Kind {
    pub(crate) element: &'static str,
    pub(crate) codec: Codec,
    pub(crate) input: Input,
    pub(crate) force: Force,
    /// How much better than plain quantiser theory this encoder does on real, detailed frames, in
    /// dB; negative if worse; none where that depends on the preset. See [`super::quality`].
    pub(crate) gain_db: Option<f64>,
    /// Whether it is never chosen without being named in the configuration.
    pub(crate) only_by_name: bool,
    pub(crate) properties: &'static [Property],
}

/// [`Kind::gain_db`] of encoders that were never measured: as bad as the worst that was.
const ASSUMED_GAIN_DB: Option<f64> = Some(-2.0);

const fn must(names: &'static [&'static str], value: &'static str) -> Property {
    Property {
        names,
        value,
        need: Need::Must,
    }
}

const fn attempt(names: &'static [&'static str], value: &'static str) -> Property {
    Property {
        names,
        value,
        need: Need::Try,
    }
}

/// `nvv4l2h264enc` and `nvv4l2h265enc` take the same properties. `iframeinterval` and
/// `idrinterval` are two things: only at an IDR frame can decoding start, so both are set. A
/// constant quantiser needs rate control off *and* the preset off.
const NVV4L2: &[Property] = &[
    must(&["ratecontrol-enable"], "false"),
    must(&["preset-level"], "DisablePreset"),
    must(&["quant-i-frames"], "{qp}"),
    must(&["quant-p-frames"], "{qp}"),
    must(&["iframeinterval"], "{gop}"),
    must(&["idrinterval"], "{gop}"),
    must(&["insert-sps-pps"], "true"),
    attempt(&["num-B-Frames"], "0"),
    attempt(&["insert-vui"], "true"),
    attempt(&["maxperf-enable"], "true"),
];

/// All rows, in order of preference: hardware, then x264enc. `openh264enc` stands behind it because
/// its constant quantiser is a range of one value under a rate control that must not bite; it is
/// there for machines without the GPL plugins. x265enc is last and never chosen by itself
/// ([`crate::discover::choose`]): it takes 75 % of a core where x264enc takes 9.5 %, for a tenth
/// fewer bytes.
///
/// x264enc runs at a preset for the pixel rate ([`super::Preset`]). Key frames get the quantiser of
/// the others (`ip-factor` 1), so that no frame is worse than the quality asks for.
pub(crate) static KINDS: &[Kind] = &[
    Kind {
        element: "nvv4l2h265enc",
        codec: Codec::H265,
        input: Input::NvmmNv12,
        force: Force::Signal("force-IDR"),
        gain_db: ASSUMED_GAIN_DB,
        only_by_name: false,
        properties: NVV4L2,
    },
    Kind {
        element: "nvv4l2h264enc",
        codec: Codec::H264,
        input: Input::NvmmNv12,
        force: Force::Signal("force-IDR"),
        gain_db: ASSUMED_GAIN_DB,
        only_by_name: false,
        properties: NVV4L2,
    },
    Kind {
        element: "nvh265enc",
        codec: Codec::H265,
        input: Input::Nv12,
        force: Force::Event,
        gain_db: ASSUMED_GAIN_DB,
        only_by_name: false,
        properties: &[
            must(&["rc-mode", "rate-control"], "constqp"),
            must(&["qp-const", "qp-const-i"], "{qp}"),
            attempt(&["qp-const-p"], "{qp}"),
            must(&["gop-size"], "{gop}"),
            attempt(&["bframes", "b-frames"], "0"),
            attempt(&["rc-lookahead"], "0"),
            attempt(&["i-adapt"], "false"),
            attempt(&["b-adapt"], "false"),
            attempt(&["spatial-aq"], "false"),
            attempt(&["temporal-aq"], "false"),
            attempt(&["zerolatency", "zero-reorder-delay"], "true"),
            attempt(&["repeat-sequence-header"], "true"),
            attempt(&["aud"], "false"),
        ],
    },
    Kind {
        element: "vah265enc",
        codec: Codec::H265,
        input: Input::Nv12,
        force: Force::Event,
        gain_db: ASSUMED_GAIN_DB,
        only_by_name: false,
        properties: &[
            must(&["rate-control"], "cqp"),
            must(&["qpi"], "{qp}"),
            must(&["qpp"], "{qp}"),
            must(&["key-int-max"], "{gop}"),
            attempt(&["b-frames"], "0"),
            attempt(&["aud"], "false"),
        ],
    },
    Kind {
        element: "qsvh265enc",
        codec: Codec::H265,
        input: Input::Nv12,
        force: Force::Event,
        gain_db: ASSUMED_GAIN_DB,
        only_by_name: false,
        properties: &[
            must(&["rate-control"], "cqp"),
            must(&["qp-i"], "{qp}"),
            must(&["qp-p"], "{qp}"),
            must(&["gop-size"], "{gop}"),
            attempt(&["idr-interval"], "0"),
            attempt(&["b-frames"], "0"),
            attempt(&["low-latency"], "true"),
        ],
    },
    Kind {
        element: "x264enc",
        codec: Codec::H264,
        input: Input::I420,
        force: Force::Event,
        gain_db: None,
        only_by_name: false,
        properties: &[
            must(&["speed-preset"], "{preset}"),
            must(&["tune"], "zerolatency"),
            must(&["pass"], "quant"),
            must(&["quantizer"], "{qp}"),
            must(&["ip-factor"], "1.0"),
            must(&["key-int-max"], "{gop}"),
            must(&["bframes"], "0"),
            must(&["threads"], "{threads}"),
            must(&["sliced-threads"], "{sliced}"),
            must(&["aud"], "false"),
            must(&["option-string"], "scenecut=0:open-gop=0"),
        ],
    },
    Kind {
        element: "openh264enc",
        codec: Codec::H264,
        input: Input::I420,
        force: Force::Event,
        gain_db: Some(-1.4),
        only_by_name: false,
        properties: &[
            must(&["rate-control"], "quality"),
            must(&["qp-min"], "{qp}"),
            must(&["qp-max"], "{qp}"),
            must(&["bitrate"], "100000000"),
            must(&["gop-size"], "{gop}"),
            must(&["scene-change-detection"], "false"),
            attempt(&["adaptive-quantization"], "false"),
            attempt(&["background-detection"], "false"),
            attempt(&["enable-frame-skip"], "false"),
            attempt(&["multi-thread"], "{threads}"),
            attempt(&["complexity"], "low"),
        ],
    },
    Kind {
        element: "x265enc",
        codec: Codec::H265,
        input: Input::I420,
        force: Force::Event,
        gain_db: Some(-2.0),
        only_by_name: true,
        properties: &[
            must(&["speed-preset"], "ultrafast"),
            must(&["tune"], "zerolatency"),
            must(&["qp"], "{qp}"),
            must(&["key-int-max"], "{gop}"),
            // Not repeat-headers: with it x265enc 1.22 puts freed memory in front of the first
            // frame (1 encoder in 50 when several run; the parser repeats the headers anyway).
            must(
                &["option-string"],
                "pools={pools}:frame-threads=1:bframes=0:scenecut=0:open-gop=0:ipratio=1.0:\
                 aq-mode=0:psy-rd=0:psy-rdoq=0:info=0",
            ),
        ],
    },
];

/// The row of an element, if we know it.
pub(crate) fn find(element: &str) -> Option<&'static Kind> {
    KINDS.iter().find(|kind| kind.element == element)
}
