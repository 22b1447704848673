//! Shoes with their tags.

use cad_transforms::RigidTransform;
use fiducials::Tag;

/// A foot of the wearer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Side {
    /// The wearer's left.
    Left,
    /// The wearer's right.
    Right,
}

/// A tag on a shoe.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ShoeTag {
    /// What is printed.
    pub tag: Tag,
    /// Takes points of the tag to the foot, m.
    pub foot_from_tag: RigidTransform,
}

/// A shoe.
#[derive(Clone, Debug, PartialEq)]
pub struct Shoe {
    /// Which foot.
    pub side: Side,
    /// Its tags.
    pub tags: Vec<ShoeTag>,
}
