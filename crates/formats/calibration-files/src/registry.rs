//! The table of formats: the only place that lists them all.

use camera_models::LensModel;

use crate::entry::Entry;
use crate::format::Format;
use crate::{
    basalt, colmap, euroc, kalibr, kitti, middlebury, nerfstudio, opencv, pair, ros, rosys,
    zed_conf,
};

/// All formats. Where a file has the signs of several, the first one is taken.
pub(crate) static ENTRIES: [Entry; 13] = [
    zed_conf::ENTRY,
    kitti::ENTRY,
    pair::ENTRY,
    kalibr::ENTRY,
    basalt::ENTRY,
    ros::ENTRY,
    opencv::ENTRY,
    euroc::ENTRY,
    colmap::TEXT,
    colmap::BINARY,
    nerfstudio::ENTRY,
    rosys::ENTRY,
    middlebury::ENTRY,
];

/// The entry of a format.
pub(crate) fn entry(format: Format) -> &'static Entry {
    let found = ENTRIES.iter().find(|entry| entry.format == format);
    found.expect("every format is in the table")
}

impl Format {
    /// The lens models of the format, the smallest of a family first.
    pub fn models(self) -> &'static [LensModel] {
        entry(self).models
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_is_in_the_table_once() {
        for format in Format::ALL {
            let count = ENTRIES.iter().filter(|entry| entry.format == format);
            assert_eq!(count.count(), 1, "{}", format.name());
        }
    }
}
