//! Images in the pixel layouts of devices.

use crate::rig::PixelFormat;
use crate::simulation::StereoFrame;

impl StereoFrame {
    /// Pixels in this layout, rows without padding.
    pub fn pixels(&self, format: PixelFormat) -> Vec<u8> {
        let (width, half) = (self.width, self.width / 2);
        let (luma, chroma) = self.i420.split_at(width * self.height);
        let (cb, cr) = chroma.split_at(half * self.height / 2);
        match format {
            PixelFormat::Nv12 => {
                let pairs = cb.iter().zip(cr).flat_map(|(b, r)| [*b, *r]);
                luma.iter().copied().chain(pairs).collect()
            }
            PixelFormat::Yuyv => {
                let mut out = Vec::with_capacity(2 * luma.len());
                for (y, row) in luma.chunks_exact(width).enumerate() {
                    // Two rows share the chroma that was computed for both.
                    let from = y / 2 * half;
                    let chroma = cb[from..from + half].iter().zip(&cr[from..from + half]);
                    for (pair, (b, r)) in row.chunks_exact(2).zip(chroma) {
                        out.extend([pair[0], *b, pair[1], *r]);
                    }
                }
                out
            }
        }
    }

    /// Replaces the lower part by that of `before`, from the row at the fraction `at` of the
    /// height.
    pub(crate) fn tear(&mut self, before: &Self, at: f64) {
        let row = (at * (self.height / 2) as f64) as usize;
        let (luma, half) = (self.width * self.height, self.width / 2);
        self.i420[2 * row * self.width..luma]
            .copy_from_slice(&before.i420[2 * row * self.width..luma]);
        for plane in 0..2 {
            let begin = luma + plane * (half * self.height / 2);
            let torn = begin + row * half..begin + half * self.height / 2;
            self.i420[torn.clone()].copy_from_slice(&before.i420[torn]);
        }
    }
}
