//! Materials and classes of surfaces.

/// Class of a surface. The numbers are those of class images.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[repr(u8)]
pub enum Class {
    /// Nothing: the sky.
    Sky = 0,
    /// Walkway for people.
    Pavement = 1,
    /// Carriageway for vehicles.
    Road = 2,
    /// Painted crossing of a road.
    Crosswalk = 3,
    /// Grass, earth, forest floor.
    Grass = 4,
    /// Tread or riser of a stair.
    Stair = 5,
    /// Wall, house front, ceiling.
    Wall = 6,
    /// Any other obstacle: pole, tree, stone, furniture, rail.
    Obstacle = 7,
    /// A person, the wearer included.
    Person = 8,
    /// A pane.
    Glass = 9,
}

impl Class {
    /// All classes, by number.
    pub const ALL: [Self; 10] = [
        Self::Sky,
        Self::Pavement,
        Self::Road,
        Self::Crosswalk,
        Self::Grass,
        Self::Stair,
        Self::Wall,
        Self::Obstacle,
        Self::Person,
        Self::Glass,
    ];

    /// Name in files, in lower case.
    pub fn name(self) -> &'static str {
        match self {
            Self::Sky => "sky",
            Self::Pavement => "pavement",
            Self::Road => "road",
            Self::Crosswalk => "crosswalk",
            Self::Grass => "grass",
            Self::Stair => "stair",
            Self::Wall => "wall",
            Self::Obstacle => "obstacle",
            Self::Person => "person",
            Self::Glass => "glass",
        }
    }
}

/// Appearance and class of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material {
    /// Class.
    pub class: Class,
    /// Whether people walk on it.
    pub walkable: bool,
    /// Index of its texture in the scene.
    pub texture: u16,
    /// Length of one texel, m.
    pub texel_m: f32,
    /// Reflectance where the texture is 1, linear red, green, blue.
    pub albedo: [f32; 3],
    /// Reflectance where the texture's second channel is full.
    pub other_albedo: [f32; 3],
    /// Emitted light while lamps are on, relative to a white surface in daylight.
    pub glow: f32,
}
