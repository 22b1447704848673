//! What a driver's sequence numbers say of the frames that did not come. Pure.

/// Follows the sequence numbers of a stream.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sequence {
    last: Option<u32>,
}

/// How a number follows the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// The first one of all.
    First,
    /// The next one.
    Next,
    /// Number of frames missed in between.
    Missed(u32),
    /// The same one again.
    Repeated,
    /// Number by which it decreased: the stream has restarted, or the driver is confused.
    Back(u32),
}

impl Sequence {
    /// Takes the next number. The wrap at 2^32 is a step like any other; a step by half of that or
    /// more is one back.
    pub fn follow(&mut self, sequence: u32) -> Step {
        let Some(last) = self.last.replace(sequence) else {
            return Step::First;
        };
        match sequence.wrapping_sub(last) {
            0 => Step::Repeated,
            1 => Step::Next,
            step if step < 1 << 31 => Step::Missed(step - 1),
            step => Step::Back(step.wrapping_neg()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn steps() {
        let mut sequence = Sequence::default();
        for (number, step) in [
            (5, Step::First),
            (6, Step::Next),
            (10, Step::Missed(3)),
            (10, Step::Repeated),
            (7, Step::Back(3)),
            (u32::MAX, Step::Back(8)),
            (0, Step::Next),
            (u32::MAX - 1, Step::Back(2)),
            (2, Step::Missed(3)),
            (2 + (1 << 31) - 1, Step::Missed((1 << 31) - 2)),
            (1, Step::Back(1 << 31)),
        ] as [(u32, Step); 11]
        {
            assert_eq!(sequence.follow(number), step, "{number}");
        }
    }
}
