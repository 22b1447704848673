//! Names of the formats of calibration files.

/// Formats of calibration files that are read and written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Stereolabs factory file `SNnnnn.conf`.
    ZedConf,
    /// EuRoC / ASL folder with `sensor.yaml` files.
    Euroc,
    /// KITTI odometry `calib.txt` with projection matrices.
    Kitti,
    /// `K.txt` with one camera matrix and a baseline, for a rectified pair.
    Pair,
    /// Kalibr `camchain.yaml`, with `imu.yaml` beside it.
    Kalibr,
    /// Basalt `calibration.json`.
    Basalt,
    /// OpenCV FileStorage YAML: `K1 D1 K2 D2 R T` and the like.
    OpenCv,
    /// COLMAP `cameras.txt`, with `rigs.txt` beside it.
    Colmap,
    /// COLMAP `cameras.bin`, with `rigs.txt` beside it.
    ColmapBin,
    /// nerfstudio and instant-ngp `transforms.json`.
    Nerfstudio,
    /// ROS `camera_info` YAML, one file per camera.
    Ros,
    /// RoSys camera JSON.
    Rosys,
    /// Middlebury stereo `calib.txt`.
    Middlebury,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 13] = [
        Self::ZedConf,
        Self::Euroc,
        Self::Kitti,
        Self::Pair,
        Self::Kalibr,
        Self::Basalt,
        Self::OpenCv,
        Self::Colmap,
        Self::ColmapBin,
        Self::Nerfstudio,
        Self::Ros,
        Self::Rosys,
        Self::Middlebury,
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::ZedConf => "zed",
            Self::Euroc => "euroc",
            Self::Kitti => "kitti",
            Self::Pair => "pair",
            Self::Kalibr => "kalibr",
            Self::Basalt => "basalt",
            Self::OpenCv => "opencv",
            Self::Colmap => "colmap",
            Self::ColmapBin => "colmap-bin",
            Self::Nerfstudio => "nerfstudio",
            Self::Ros => "ros",
            Self::Rosys => "rosys",
            Self::Middlebury => "middlebury",
        }
    }

    /// The format of a name on the command line.
    ///
    /// ```
    /// use calibration_files::Format;
    /// use camera_models::LensModel;
    ///
    /// assert_eq!(Format::from_name("kalibr"), Some(Format::Kalibr));
    /// assert_eq!(Format::from_name("matlab"), None);
    /// assert!(Format::ALL.into_iter().all(|format| Format::from_name(format.name()) == Some(format)));
    /// // What a format can hold of a lens.
    /// assert!(Format::Kalibr.models().contains(&LensModel::DoubleSphere));
    /// assert!(!Format::OpenCv.models().contains(&LensModel::DoubleSphere));
    /// ```
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }
}
