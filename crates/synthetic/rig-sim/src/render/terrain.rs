//! Ground truth of the terrain and of the soles that stand on it, as tables. World frame, m.

use std::fmt::Write as _;

use crate::scene::terrain::{Planes, StepEdge};
use crate::walker::gait::{HALF_WIDTH, HEEL_X, TOE_X};

/// Planes by area; the row number from 0 is the plane's number in `scene.ply`.
pub(crate) fn planes(planes: &Planes) -> String {
    let mut text = "#x [m],y [m],z [m],normal_x [],normal_y [],normal_z [],area [m^2]\n".to_owned();
    for plane in &planes.planes {
        let (p, n) = (plane.middle, plane.normal);
        // Writing to a string does not fail.
        let _ = writeln!(
            text,
            "{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{:.4}",
            p.x, p.y, p.z, n.x, n.y, n.z, plane.area_m2
        );
    }
    text
}

/// Upper ends of each step edge, the lower side on its right, and the height below each end.
pub(crate) fn step_edges(edges: &[StepEdge]) -> String {
    let mut text =
        "#x0 [m],y0 [m],z0 [m],x1 [m],y1 [m],z1 [m],height0 [m],height1 [m]\n".to_owned();
    for edge in edges {
        let [a, b] = edge.ends;
        let [first, last] = edge.heights_m();
        let _ = writeln!(
            text,
            "{:.6},{:.6},{:.6},{:.6},{:.6},{:.6},{first:.6},{last:.6}",
            a.x, a.y, a.z, b.x, b.y, b.z
        );
    }
    text
}

/// Outline of the sole of either shoe, counter-clockwise from above, in the foot's frame.
pub(crate) fn soles() -> String {
    let mut text = "#side,x [m],y [m]\n".to_owned();
    for side in ["left", "right"] {
        for (x, y) in [
            (HEEL_X, -HALF_WIDTH),
            (TOE_X, -HALF_WIDTH),
            (TOE_X, HALF_WIDTH),
            (HEEL_X, HALF_WIDTH),
        ] {
            let _ = writeln!(text, "{side},{x},{y}");
        }
    }
    text
}
