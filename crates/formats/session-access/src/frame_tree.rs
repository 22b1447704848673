//! Coordinate frames of a session's rig, and the transforms between them.

use std::collections::{BTreeMap, VecDeque};

use cad_transforms::RigidTransform;
use session_archive::record::FrameTransforms;

/// The transforms of a session. Invalid rigid transforms are left out.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    edges: Vec<(String, String, RigidTransform)>,
}

impl Frames {
    /// The transforms of a record.
    pub fn of(record: &FrameTransforms) -> Self {
        let edges = record.transforms.iter().filter_map(|t| {
            let q = t.rotation.as_ref()?;
            let p = t.translation.as_ref()?;
            // The message names the components; the transform takes `w` first.
            let parent_from_child =
                RigidTransform::from_wxyz([q.w, q.x, q.y, q.z], [p.x, p.y, p.z]).ok()?;
            Some((
                t.parent_frame_id.clone(),
                t.child_frame_id.clone(),
                parent_from_child,
            ))
        });
        Self {
            edges: edges.collect(),
        }
    }

    /// Whether there is no transform.
    pub fn is_empty(&self) -> bool {
        self.edges.is_empty()
    }

    /// `b_from_a` along the shortest chain of transforms; `None` if `a` and `b` are not connected.
    pub fn transform(&self, b: &str, a: &str) -> Option<RigidTransform> {
        let mut known = BTreeMap::from([(a, RigidTransform::identity())]);
        let mut queue = VecDeque::from([a]);
        while let Some(at) = queue.pop_front() {
            let at_from_a = known[at];
            if at == b {
                return Some(at_from_a);
            }
            for (parent, child, parent_from_child) in &self.edges {
                let (next, next_from_at) = if child == at {
                    (parent, *parent_from_child)
                } else if parent == at {
                    (child, parent_from_child.inverse())
                } else {
                    continue;
                };
                if !known.contains_key(next.as_str()) {
                    known.insert(next, next_from_at * at_from_a);
                    queue.push_back(next);
                }
            }
        }
        None
    }
}
