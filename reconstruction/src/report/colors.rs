//! Color map: blue for the least value, over green and yellow to dark red. Distinguishable on
//! white, in print, and with red–green color blindness.

/// Anchor colors at equal steps.
pub(super) const ANCHORS: [[u8; 3]; 5] = [
    [27, 79, 138],
    [42, 157, 143],
    [233, 180, 76],
    [209, 73, 60],
    [110, 12, 30],
];
/// The same on a dark screen, where dark blue and dark red would not be visible.
pub(super) const DARK: [[u8; 3]; 5] = [
    [92, 156, 232],
    [62, 196, 178],
    [242, 200, 104],
    [244, 124, 92],
    [255, 78, 132],
];
/// Color of a missing value.
pub(super) const UNKNOWN: [u8; 3] = [140, 140, 140];

/// Color of a value from 0 to 1; values outside are clamped.
pub(super) fn ramp(share: f64) -> [u8; 3] {
    between(&ANCHORS, share)
}

/// The same on a dark screen.
pub(super) fn dark_ramp(share: f64) -> [u8; 3] {
    between(&DARK, share)
}

fn between(anchors: &[[u8; 3]; 5], share: f64) -> [u8; 3] {
    let place = share.clamp(0.0, 1.0) * (anchors.len() - 1) as f64;
    let below = (place as usize).min(anchors.len() - 2);
    let part = place - below as f64;
    [0, 1, 2].map(|k| {
        let [a, b] = [anchors[below][k], anchors[below + 1][k]].map(f64::from);
        (a + (b - a) * part).round() as u8
    })
}

/// As in SVG.
pub(super) fn hex([red, green, blue]: [u8; 3]) -> String {
    format!("#{red:02x}{green:02x}{blue:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ramp_goes_through_its_anchors() {
        for (k, anchor) in ANCHORS.iter().enumerate() {
            assert_eq!(ramp(k as f64 / 4.0), *anchor);
            assert_eq!(dark_ramp(k as f64 / 4.0), DARK[k]);
        }
        assert_eq!(ramp(7.0), ANCHORS[4]);
        assert_eq!(ramp(-1.0), ANCHORS[0]);
        assert_eq!(hex([1, 171, 16]), "#01ab10");
    }
}
