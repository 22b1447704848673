//! Axes: what a value means, which range is shown, where the ticks stand and what they say.
//!
//! Ranges follow the data. Ticks are 1-2-5 steps on linear axes, decades
//! (or 1-2-5 within them) on log axes, and whole seconds, minutes or hours on time axes.

/// One axis of a chart.
#[derive(Clone, Debug)]
pub struct Axis {
    label: String,
    unit: String,
    kind: Kind,
    include: Vec<f64>,
}

#[derive(Clone, Debug, PartialEq)]
enum Kind {
    Linear,
    Log,
    Time,
    Categories(Vec<String>),
}

impl Axis {
    fn new(label: &str, unit: &str, kind: Kind) -> Self {
        Self {
            label: label.into(),
            unit: unit.into(),
            kind,
            include: Vec::new(),
        }
    }

    /// A linear axis, captioned "label (unit)"; an empty unit is left out.
    pub fn linear(label: &str, unit: &str) -> Self {
        Self::new(label, unit, Kind::Linear)
    }

    /// A log axis. Values that are not above zero cannot be drawn on it.
    pub fn log(label: &str, unit: &str) -> Self {
        Self::new(label, unit, Kind::Log)
    }

    /// Time in seconds, with ticks at whole minutes and hours where the range is long.
    pub fn time(label: &str) -> Self {
        Self::new(label, "", Kind::Time)
    }

    /// Named places 0, 1, 2, ...; for bars.
    pub fn categories<T: Into<String>>(label: &str, names: impl IntoIterator<Item = T>) -> Self {
        Self::new(
            label,
            "",
            Kind::Categories(names.into_iter().map(Into::into).collect()),
        )
    }

    /// Widens the range so that it holds `value`; 0 so that bar lengths are proportional.
    pub fn include(mut self, value: f64) -> Self {
        self.include.push(value);
        self
    }

    pub(crate) fn is_log(&self) -> bool {
        self.kind == Kind::Log
    }

    pub(crate) fn category_names(&self) -> Option<&[String]> {
        match &self.kind {
            Kind::Categories(names) => Some(names),
            _ => None,
        }
    }

    /// Whether a value can have a place on this axis at all.
    pub(crate) fn usable(&self, v: f64) -> bool {
        v.abs() < 1e100 && (!self.is_log() || v > 1e-100)
    }

    /// The range to show for data of this extent. `pad` is the share added on each side; `nice`
    /// widens a linear range to whole steps.
    pub(crate) fn resolve(
        &self,
        mut data: Extent,
        pad: f64,
        nice: bool,
        most: usize,
    ) -> (f64, f64) {
        if let Some(names) = self.category_names() {
            return (-0.5, names.len().max(1) as f64 - 0.5);
        }
        self.include
            .iter()
            .filter(|&&v| self.usable(v))
            .for_each(|&v| data.add(v));
        let (lo, hi) = data.0.unwrap_or(if self.is_log() {
            (1.0, 10.0)
        } else {
            (0.0, 1.0)
        });
        if self.is_log() {
            let pad = ((hi / lo).log10() * pad).max(0.05);
            return (lo * 10f64.powf(-pad), hi * 10f64.powf(pad));
        }
        let size = lo.abs().max(hi.abs());
        let pad = match hi - lo {
            span if size < 1e-90 || span.is_nan() => 1.0,
            span if span <= size * 1e-12 => size * 0.1,
            span => span * pad,
        };
        // What is never negative gets no negative range by padding, and the other way round.
        let (mut a, mut b) = (lo - pad, hi + pad);
        a = if lo >= 0.0 { a.max(0.0) } else { a };
        b = if hi <= 0.0 && lo < 0.0 { b.min(0.0) } else { b };
        if nice && self.kind == Kind::Linear {
            // The widened range may call for a wider step; widening to that one settles it.
            let widen = |step: f64| ((a / step).floor() * step, (b / step).ceil() * step);
            let first = widen(linear_step(b - a, most));
            (a, b) = widen(linear_step(first.1 - first.0, most));
        }
        (a, b)
    }

    /// Ticks within `lo..=hi`, about `most` at most, each with its text.
    pub(crate) fn ticks(&self, (lo, hi): (f64, f64), most: usize) -> Vec<(f64, String)> {
        let write = |values: Vec<f64>, text: &dyn Fn(f64) -> String| -> Vec<(f64, String)> {
            values.into_iter().map(|v| (v, text(v))).collect()
        };
        let size = lo.abs().max(hi.abs());
        let step = linear_step(hi - lo, most);
        let fine = linear_step(hi - lo, most.max(5));
        match &self.kind {
            Kind::Categories(names) => names
                .iter()
                .enumerate()
                .map(|(i, name)| (i as f64, name.clone()))
                .collect(),
            Kind::Time if self.clock_unit(lo, hi) != "s" => {
                write(multiples(lo, hi, time_step(hi - lo, most)), &|v| {
                    clock(v, size)
                })
            }
            Kind::Log => match log_ticks(lo, hi, most) {
                Some(values) => write(values, &|v| tick_text(v, v, v)),
                None => write(multiples(lo, hi, fine), &|v| tick_text(v, fine, size)),
            },
            _ => write(multiples(lo, hi, step), &|v| tick_text(v, step, size)),
        }
    }

    pub(crate) fn has_caption(&self) -> bool {
        !self.caption((0.0, 1.0)).is_empty()
    }

    /// "label (unit)".
    pub(crate) fn caption(&self, (lo, hi): (f64, f64)) -> String {
        let unit = if self.kind == Kind::Time {
            self.clock_unit(lo, hi)
        } else {
            &self.unit
        };
        match (self.label.as_str(), unit) {
            (label, "") => label.into(),
            ("", unit) => unit.into(),
            (label, unit) => format!("{label} ({unit})"),
        }
    }

    fn clock_unit(&self, lo: f64, hi: f64) -> &'static str {
        match lo.abs().max(hi.abs()) {
            size if size < 100.0 || hi - lo < 10.0 => "s",
            size if size < 3600.0 => "min:s",
            _ => "h:min:s",
        }
    }
}

/// The least and greatest value seen.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Extent(pub(crate) Option<(f64, f64)>);

impl Extent {
    pub(crate) fn add(&mut self, v: f64) {
        let (lo, hi) = self.0.unwrap_or((v, v));
        self.0 = Some((lo.min(v), hi.max(v)));
    }
}

/// A resolved axis: values to pixels. Total: what a log axis cannot show lands on its low end.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    pub(crate) range: (f64, f64),
    pub(crate) log: bool,
    pub(crate) pixels: (f64, f64),
}

impl Scale {
    pub(crate) fn at(&self, v: f64) -> f64 {
        let (lo, hi) = self.range;
        let share = match self.log {
            true if v <= 0.0 => 0.0,
            true => (v / lo).ln() / (hi / lo).ln(),
            false => (v - lo) / (hi - lo),
        };
        self.pixels.0 + share * (self.pixels.1 - self.pixels.0)
    }

    pub(crate) fn holds(&self, v: f64) -> bool {
        (self.range.0..=self.range.1).contains(&v)
    }
}

/// The smallest 1-2-5 step that makes at most about `most` steps of `span`.
pub(crate) fn linear_step(span: f64, most: usize) -> f64 {
    let raw = span / most.max(1) as f64;
    let decade = 10f64.powf(raw.log10().floor());
    let factor = [1.0, 2.0, 5.0]
        .into_iter()
        .find(|f| f * decade >= raw * (1.0 - 1e-9))
        .unwrap_or(10.0);
    factor * decade
}

fn time_step(span: f64, most: usize) -> f64 {
    const STEPS: [f64; 16] = [
        10.0, 15.0, 30.0, 60.0, 120.0, 300.0, 600.0, 900.0, 1800.0, 3600.0, 7200.0, 10800.0,
        14400.0, 21600.0, 43200.0, 86400.0,
    ];
    match span / most.max(1) as f64 {
        raw if raw <= 5.0 => linear_step(span, most),
        raw => STEPS
            .into_iter()
            .find(|step| *step >= raw)
            .unwrap_or_else(|| linear_step(span, most)),
    }
}

fn multiples(lo: f64, hi: f64, step: f64) -> Vec<f64> {
    let (first, last) = ((lo / step - 1e-9).ceil(), (hi / step + 1e-9).floor());
    let count = (last - first + 1.0).clamp(0.0, 200.0) as usize;
    (0..count)
        .map(|i| (first + i as f64) * step + 0.0)
        .collect()
}

/// Decades; 1-2-5 or all digits within them where there are fewer than three; none
/// where the range is only a part of a decade and plain steps serve better.
fn log_ticks(lo: f64, hi: f64, most: usize) -> Option<Vec<f64>> {
    let (first, last) = (lo.log10().floor() as i32, hi.log10().ceil() as i32);
    let within = |digits: &[f64], every: usize| -> Vec<f64> {
        let all = (first..=last).step_by(every);
        let all = all.flat_map(|e| digits.iter().map(move |d| d * 10f64.powi(e)));
        all.filter(|v| (lo * (1.0 - 1e-9)..=hi * (1.0 + 1e-9)).contains(v))
            .collect()
    };
    let every = ((last - first) as usize).div_ceil((most * 3 / 2).max(1));
    let sparse = (2..=every)
        .rev()
        .map(|every| within(&[1.0], every))
        .find(|ticks| ticks.len() >= 3);
    if sparse.is_some() {
        return sparse;
    }
    for digits in [
        &[1.0][..],
        &[1.0, 2.0, 5.0],
        &[1.0, 2.0, 3.0, 4.0, 6.0, 8.0],
    ] {
        let ticks = within(digits, 1);
        if ticks.len() >= 3 {
            return Some(ticks);
        }
    }
    None
}

/// A tick among ticks `step` apart and `size` large at most.
fn tick_text(v: f64, step: f64, size: f64) -> String {
    let exponent = |v: f64| (v.abs() * 1.0001).log10().floor() as i32;
    if v == 0.0 {
        "0".into()
    } else if (1e-4..1e6).contains(&size) {
        format!("{v:.*}", exponent(step).min(0).unsigned_abs() as usize)
    } else {
        scientific(
            v,
            exponent(v),
            (exponent(v) - exponent(step)).clamp(0, 15) as usize,
        )
    }
}

/// `2.50×10⁻⁶`, and plain `10⁻⁶` for a power of ten.
fn scientific(v: f64, exponent: i32, decimals: usize) -> String {
    let mantissa = format!("{:.decimals$}", v / 10f64.powi(exponent));
    let power: String = exponent.to_string().chars().map(superscript).collect();
    if mantissa == "1" {
        format!("10{power}")
    } else {
        format!("{mantissa}×10{power}")
    }
}

fn superscript(c: char) -> char {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    c.to_digit(10).map_or('⁻', |digit| DIGITS[digit as usize])
}

/// Seconds as `m:ss` or `h:mm:ss`; `size` is the longest time beside it.
fn clock(seconds: f64, size: f64) -> String {
    let sign = if seconds < 0.0 { "-" } else { "" };
    let s = seconds.abs().round() as u64;
    match size {
        size if size < 3600.0 => format!("{sign}{}:{:02}", s / 60, s % 60),
        _ => format!("{sign}{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60),
    }
}

/// A number to three significant digits, without needless zeros.
pub fn significant(v: f64) -> String {
    if !v.is_finite() {
        return "n/a".into();
    }
    if v.abs() < 1e-100 {
        return "0".into();
    }
    let exponent = (v.abs() * 1.0001).log10().floor() as i32;
    if !(-4..9).contains(&exponent) {
        // The fewest decimals that say the same to three digits.
        let texts = [0, 1, 2]
            .map(|decimals| (decimals, format!("{:.decimals$}", v / 10f64.powi(exponent))));
        let value = |text: &str| text.parse::<f64>().ok();
        let enough = texts
            .iter()
            .find(|(_, text)| value(text) == value(&texts[2].1));
        return scientific(v, exponent, enough.map_or(2, |(decimals, _)| *decimals));
    }
    let text = format!("{v:.*}", (2 - exponent).max(0) as usize);
    if text.contains('.') {
        text.trim_end_matches('0').trim_end_matches('.').into()
    } else {
        text
    }
}

/// A number with a unit and an SI prefix: `si(0.01, "s")` is "10 ms", `si(1.5e9, "B/s")` "1.5
/// GB/s".
pub fn si(v: f64, unit: &str) -> String {
    const PREFIXES: [&str; 11] = ["p", "n", "µ", "m", "", "k", "M", "G", "T", "P", "E"];
    // Rounded before the prefix is chosen, so that 999.9 becomes 1 k and not 1000.
    let rounded: f64 = format!("{v:.2e}").parse().unwrap_or(v);
    if rounded == 0.0 || !rounded.is_finite() {
        return format!("{} {unit}", significant(v)).trim_end().into();
    }
    let exponent = (rounded.abs() * 1.0001).log10().floor() as i32;
    let index = (exponent.div_euclid(3) + 4).clamp(0, 10);
    let number = significant(rounded / 10f64.powi((index - 4) * 3));
    format!("{number} {}{unit}", PREFIXES[index as usize])
        .trim_end()
        .into()
}
