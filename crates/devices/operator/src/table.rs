//! The table of lights and beeps, to print on one page: as an image and as text.
//!
//! Made from the [patterns](crate::pattern) themselves, so it cannot say anything else than the
//! light does. `cargo run -p operator --example led_table` writes both into `docs/`; a test holds
//! them to what this module makes.

use std::fmt::Write;

use crate::NS_PER_MS;
use crate::pattern::{Colour, LightState, light, sound};
use crate::signal::{Once, Phase, Signal, Warning};

/// Rows that belong together.
fn sections() -> Vec<(&'static str, Vec<Signal>)> {
    let warnings = |recording| {
        Warning::ALL
            .map(|what| Signal::Warning { what, recording })
            .to_vec()
    };
    vec![
        (
            "All is well",
            vec![
                Signal::Phase(Phase::Starting),
                Signal::Phase(Phase::Ready),
                Signal::Once(Once::Started),
                Signal::Phase(Phase::Recording),
                Signal::Once(Once::Marked),
                Signal::Phase(Phase::Saving),
            ],
        ),
        (
            "Warnings while recording: light on, with gaps",
            warnings(true),
        ),
        (
            "Warnings while not recording: light off, with flashes",
            warnings(false),
        ),
        (
            "It does not work",
            vec![Signal::Fault, Signal::Once(Once::Refused)],
        ),
        (
            "Discarding, after a long press",
            vec![Signal::Question, Signal::Once(Once::Discarded)],
        ),
    ]
}

const HOW: &str = "Press: start or stop.   Press twice: mark this moment.   \
     Hold for 1.5 s, then press once within 5 s: discard the recording.";

/// A4 landscape at five units per millimetre.
const WIDTH: u32 = 1485;
const HEIGHT: u32 = 1050;
const ROW: u32 = 40;
/// Left edges of the columns.
const SAYS_X: u32 = 36;
const COLOUR_X: u32 = 366;
const LIT_X: u32 = 626;
const BEEP_X: u32 = 886;
const DO_X: u32 = 1018;
/// Time shown by a bar, and units per second.
const SHOWN_MS: u32 = 4_000;
const PER_SECOND: u32 = 60;
const BAR: u32 = SHOWN_MS * PER_SECOND / 1000;

const INK: &str = "#1b1b1b";
const FAINT: &str = "#6a6a6a";
const DARK: &str = "#2c2c2c";

/// The page to print, as SVG.
pub fn svg() -> String {
    let mut page = Page(String::new());
    let _ = writeln!(
        page.0,
        r#"<svg xmlns="http://www.w3.org/2000/svg" width="297mm" height="210mm" viewBox="0 0 {WIDTH} {HEIGHT}" font-family="Liberation Sans, Arial, Helvetica, sans-serif">"#
    );
    page.rect((0, 0), (WIDTH, HEIGHT), "#ffffff");
    page.text((SAYS_X, 56), 34, INK, true, "What the light says");
    page.text((SAYS_X, 88), 18, INK, false, HOW);
    let mut y = 104;
    page.heads(y);
    y += 34;
    for (heading, signals) in sections() {
        page.text((SAYS_X, y + 19), 17, FAINT, true, heading);
        y += 27;
        for signal in signals {
            page.row(y, signal);
            y += ROW;
        }
    }
    page.text(
        (SAYS_X, y + 26),
        16,
        FAINT,
        false,
        "Bars show 4 seconds. Answers to a press last 1 second; then the light goes on as before. \
         A light of one colour tells the same by rhythm alone.",
    );
    page.0.push_str("</svg>\n");
    page.0
}

struct Page(String);

impl Page {
    fn rect(&mut self, (x, y): (u32, u32), (w, h): (u32, u32), fill: &str) {
        let _ = writeln!(
            self.0,
            r#"<rect x="{x}" y="{y}" width="{w}" height="{h}" fill="{fill}"/>"#
        );
    }

    fn text(&mut self, (x, y): (u32, u32), size: u32, fill: &str, bold: bool, text: &str) {
        let weight = if bold { r#" font-weight="bold""# } else { "" };
        // Spaces between the parts of a line are meant.
        let _ = writeln!(
            self.0,
            r#"<text x="{x}" y="{y}" font-size="{size}" fill="{fill}"{weight} xml:space="preserve">{text}</text>"#
        );
    }

    fn heads(&mut self, y: u32) {
        let base = y + 14;
        for (x, head) in [
            (SAYS_X, "Meaning"),
            (COLOUR_X, "Coloured light"),
            (LIT_X, "One colour"),
            (BEEP_X, "Beeps"),
            (DO_X, "What to do"),
        ] {
            self.text((x, base), 17, INK, true, head);
        }
        for x in [COLOUR_X, LIT_X] {
            let label = format!("{} s", SHOWN_MS / 1000);
            self.text((x + BAR - 24, base), 15, FAINT, false, &label);
        }
        self.rect((SAYS_X, y + 24), (WIDTH - 2 * SAYS_X, 2), INK);
    }

    fn row(&mut self, y: u32, signal: Signal) {
        let base = y + 26;
        let loud = matches!(
            signal,
            Signal::Phase(Phase::Recording) | Signal::Fault | Signal::Phase(Phase::Ready)
        );
        self.text((SAYS_X, base), 19, INK, loud, signal.says());
        self.text((DO_X, base), 18, INK, false, signal.do_what());
        self.bar((COLOUR_X, y + 8), signal, |look| ink(look.colour));
        self.bar((LIT_X, y + 8), signal, |look| {
            if look.lit { "#ffe27a" } else { DARK }
        });
        self.beeps((BEEP_X, y + 17), signal);
        self.rect((SAYS_X, y + ROW - 1), (WIDTH - 2 * SAYS_X, 1), "#dddddd");
    }

    fn bar(
        &mut self,
        (x, y): (u32, u32),
        signal: Signal,
        fill: impl Fn(LightState) -> &'static str,
    ) {
        const HIGH: u32 = 23;
        let pattern = light(signal);
        let units = |ms: u32| f64::from(ms * PER_SECOND) / 1000.0;
        let mut at_ms = 0;
        while at_ms < SHOWN_MS {
            let (look, next) = pattern.at(i64::from(at_ms) * NS_PER_MS);
            let Some(look) = look else { break };
            let next = next
                .map_or(SHOWN_MS, |ns| (ns / NS_PER_MS) as u32)
                .min(SHOWN_MS);
            let (left, wide) = (f64::from(x) + units(at_ms), units(next - at_ms));
            let fill = fill(look);
            let _ = writeln!(
                self.0,
                r#"<rect x="{left:.2}" y="{y}" width="{wide:.2}" height="{HIGH}" fill="{fill}"/>"#
            );
            at_ms = next;
        }
        let wide = units(at_ms);
        let _ = writeln!(
            self.0,
            r#"<rect x="{x}" y="{y}" width="{wide:.2}" height="{HIGH}" fill="none" stroke="{DARK}" stroke-width="1.5"/>"#
        );
        if at_ms < SHOWN_MS {
            let left = x + BAR * at_ms / SHOWN_MS + 12;
            self.text((left, y + 17), 15, FAINT, false, "then as before");
        }
    }

    fn beeps(&mut self, (x, y): (u32, u32), signal: Signal) {
        const PER_BEEP_MS: u32 = 13;
        let Some(sound) = sound(signal) else {
            return self.text((x, y + 8), 15, FAINT, false, "silent");
        };
        let mut left = x;
        for (tone, ms) in sound.steps {
            let wide = ms / PER_BEEP_MS;
            if tone.is_some() {
                self.rect((left, y), (wide, 7), INK);
            }
            left += wide;
        }
    }
}

/// How a colour is printed.
fn ink(colour: Colour) -> &'static str {
    match colour {
        Colour::Off => DARK,
        Colour::White => "#ffffff",
        Colour::Green => "#2eb84a",
        Colour::Orange => "#ff8c1a",
        Colour::Red => "#e5262a",
        Colour::Blue => "#3a7bff",
        Colour::Cyan => "#22c3d6",
        Colour::Magenta => "#d53ac8",
    }
}

/// The page as Markdown: the image, and the same in words.
pub fn markdown() -> String {
    let mut page = String::from(
        "# What the light says\n\n\
         Made from the code by `cargo run -p operator --example led_table`; print \
         [the page](../images/led-table.svg) on one sheet of A4, landscape.\n\n\
         ![Every state of the light with its blink pattern, its beeps, its meaning and what to do](../images/led-table.png)\n\n\
         Press: start or stop. Press twice: mark this moment. Hold for 1.5 s, then press once within 5 s: discard \
         the recording.\n\n\
         Whether it records, warns or has failed shows within 1 s of looking, on a light of one colour too: the patterns of any two \
         meanings differ for at least 120 ms in any such second. Which warning it is shows within 2 s (200 ms). \
         `crates/devices/operator/src/pattern/tests.rs` compares every pattern with every other at every phase.\n\n\
         Times are milliseconds. A light of one colour goes by the second column of patterns. Answers to a press last \
         one second; then the light goes on as before.\n",
    );
    for (heading, signals) in sections() {
        let _ = write!(
            page,
            "\n## {heading}\n\n| meaning | coloured light | light of one colour | beeps | what to do |\n|---|---|---|---|---|\n"
        );
        for signal in signals {
            let _ = writeln!(
                page,
                "| {} | {} | {} | {} | {} |",
                signal.says(),
                in_words(signal, |look| name(look.colour)),
                in_words(signal, |look| if look.lit { "on" } else { "off" }),
                beeps_in_words(signal),
                signal.do_what()
            );
        }
    }
    page
}

fn name(colour: Colour) -> &'static str {
    match colour {
        Colour::Off => "off",
        Colour::White => "white",
        Colour::Green => "green",
        Colour::Orange => "orange",
        Colour::Red => "red",
        Colour::Blue => "blue",
        Colour::Cyan => "cyan",
        Colour::Magenta => "magenta",
    }
}

fn in_words(signal: Signal, name: impl Fn(LightState) -> &'static str) -> String {
    let steps = light(signal).steps;
    if let [(look, _)] = steps[..] {
        return format!("{}, steady", name(look));
    }
    let steps: Vec<String> = steps
        .iter()
        .map(|(look, ms)| format!("{} {ms}", name(*look)))
        .collect();
    steps.join(", ")
}

fn beeps_in_words(signal: Signal) -> String {
    let Some(sound) = sound(signal) else {
        return "silent".into();
    };
    let tones = sound.steps.iter().filter_map(|(tone, ms)| tone.map(|_| ms));
    let mut words: Vec<&str> = tones
        .map(|ms| if *ms > 150 { "long" } else { "short" })
        .collect();
    let again = sound
        .again_ms
        .map(|ms| format!("again every {} s", ms / 1000));
    words.extend(again.as_deref());
    words.join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_signal_stands_in_the_table_once() {
        let mut rows: Vec<Signal> = sections().into_iter().flat_map(|(_, rows)| rows).collect();
        let mut all = Signal::all();
        let order = |signal: &Signal| format!("{signal:?}");
        rows.sort_by_key(order);
        all.sort_by_key(order);
        assert_eq!(rows, all);
    }

    #[test]
    fn no_text_is_longer_than_its_column() {
        for signal in Signal::all() {
            assert!(signal.says().len() <= 29, "{:?}", signal.says());
            assert!(signal.do_what().len() <= 40, "{:?}", signal.do_what());
        }
    }

    #[test]
    fn text_needs_no_escaping() {
        for signal in Signal::all() {
            let text = format!("{}{}{HOW}", signal.says(), signal.do_what());
            assert!(!text.contains(['<', '>', '&', '|']), "{text}");
        }
    }
}
