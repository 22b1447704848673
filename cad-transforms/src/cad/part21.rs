//! The exchange structure of ISO 10303-21, which STEP files are written in.
//!
//! Contract: `Exchange::index` finds every instance `#N = …;` of the data section and refuses a
//! file that is cut off or numbers two instances alike. An instance is parsed on demand: an
//! assembly is a few hundred entities among a million of surfaces, and those are never looked into.
//!
//! Syntax after ISO 10303-21:2016, clauses 5 to 9: `''` in strings, `\X2\…\X0\` and the other
//! directives, comments anywhere between tokens, instances of several records `( A() B() )`.
//! Anchor, reference and signature sections of edition 3 are skipped.

use std::collections::BTreeMap;

use super::Fault;

/// A parameter of a record.
#[derive(Clone, Debug, PartialEq)]
pub enum Value {
    /// `#12`
    Reference(u64),
    /// `12`, `1.5E-3`
    Number(f64),
    /// `'text'`, decoded.
    Text(String),
    /// `.MILLI.`, without the points.
    Enumeration(String),
    /// `(…)`
    List(Vec<Value>),
    /// `LENGTH_MEASURE(25.4)`
    Typed(String, Vec<Value>),
    /// `$`
    Omitted,
    /// `*`
    Derived,
    /// `"…"`, as written.
    Binary(String),
}

/// `NAME(…)`.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// Upper case.
    pub name: String,
    /// In the order of the file.
    pub parameters: Vec<Value>,
}

/// `#12 = …;`: one record, or several of a complex instance.
#[derive(Clone, Debug, PartialEq)]
pub struct Instance {
    /// Its number.
    pub id: u64,
    /// Line where it begins, from 1.
    pub line: usize,
    /// One, or several.
    pub records: Vec<Record>,
}

/// A file with the places of its instances.
#[derive(Debug)]
pub(crate) struct Exchange<'b> {
    bytes: &'b [u8],
    /// Number, offset behind the `=`, line; by number.
    places: Vec<(u64, usize, usize)>,
    /// Names of records, with the instances that have one, in the order of the file.
    names: BTreeMap<String, Vec<u64>>,
}

impl<'b> Exchange<'b> {
    /// Finds the instances.
    ///
    /// # Errors
    /// The file is no exchange structure, is cut off, or has two instances of one number.
    pub(crate) fn index(bytes: &'b [u8]) -> Result<Self, Fault> {
        let mut scan = Scan::at(bytes, 0, 1);
        scan.skip_blanks()?;
        if !scan.rest().starts_with(b"ISO-10303-21") {
            let message = "does not begin with ISO-10303-21;, so this is no STEP file";
            return Err(Fault::at_line(scan.line, message));
        }
        let mut exchange = Self {
            bytes,
            places: Vec::new(),
            names: BTreeMap::new(),
        };
        // Inside DATA there are instances, outside only headers that say nothing about placements.
        let (mut in_data, mut any_data, mut ended) = (false, false, false);
        loop {
            scan.skip_blanks()?;
            let Some(first) = scan.peek() else { break };
            let line = scan.line;
            if first == b'#' {
                let id = scan.number_sign()?;
                scan.skip_blanks()?;
                if scan.peek() != Some(b'=') {
                    return Err(Fault::new(at(line, id), "expected = after the number"));
                }
                scan.advance();
                scan.skip_blanks()?;
                if in_data {
                    exchange.places.push((id, scan.offset, line));
                }
                let names = scan.statement(Some((line, id)))?;
                if in_data {
                    for name in names {
                        exchange.names.entry(name).or_default().push(id);
                    }
                }
                continue;
            }
            let start = scan.offset;
            scan.statement(None)?;
            let word = &bytes[start..scan.offset];
            let is = |name: &[u8]| {
                word.len() >= name.len() && word[..name.len()].eq_ignore_ascii_case(name)
            };
            if is(b"END-ISO-10303-21") {
                ended = true;
                break;
            } else if is(b"DATA") {
                (in_data, any_data) = (true, true);
            } else if is(b"ENDSEC") {
                in_data = false;
            }
        }
        if !ended {
            let message = "the file ends without END-ISO-10303-21;: it is cut off";
            return Err(Fault::at_line(scan.line, message));
        }
        if !any_data {
            return Err(Fault::at_line(scan.line, "no DATA section"));
        }
        exchange.places.sort_unstable();
        if let Some(pair) = exchange
            .places
            .windows(2)
            .find(|pair| pair[0].0 == pair[1].0)
        {
            let message = format!("#{} is there already, on line {}", pair[1].0, pair[0].2);
            return Err(Fault::new(at(pair[1].2, pair[1].0), message));
        }
        Ok(exchange)
    }

    /// Numbers of the instances that have a record of this name, in the order of the file.
    pub(crate) fn named(&self, name: &str) -> &[u64] {
        self.names.get(name).map_or(&[], Vec::as_slice)
    }

    /// Takes an instance apart.
    ///
    /// # Errors
    /// There is no such instance, or it is malformed.
    pub(crate) fn instance(&self, id: u64) -> Result<Instance, Fault> {
        let Ok(found) = self.places.binary_search_by_key(&id, |place| place.0) else {
            return Err(Fault::new(
                format!("#{id}"),
                "is referred to and not in the file",
            ));
        };
        let (_, offset, line) = self.places[found];
        let mut parse = Parse {
            scan: Scan::at(self.bytes, offset, line),
            line,
            id,
            depth: 0,
        };
        let records = parse.records()?;
        Ok(Instance { id, line, records })
    }
}

impl Instance {
    /// Where it is: `line 12, #34`.
    pub fn place(&self) -> String {
        at(self.line, self.id)
    }

    /// Its record of this name.
    pub fn record(&self, name: &str) -> Option<&Record> {
        self.records.iter().find(|record| record.name == name)
    }
}

fn at(line: usize, id: u64) -> String {
    format!("line {line}, #{id}")
}

/// Goes over bytes and counts lines.
struct Scan<'b> {
    bytes: &'b [u8],
    offset: usize,
    line: usize,
}

impl<'b> Scan<'b> {
    fn at(bytes: &'b [u8], offset: usize, line: usize) -> Self {
        Self {
            bytes,
            offset,
            line,
        }
    }

    fn rest(&self) -> &'b [u8] {
        &self.bytes[self.offset..]
    }

    fn peek(&self) -> Option<u8> {
        self.bytes.get(self.offset).copied()
    }

    fn advance(&mut self) {
        if self.peek() == Some(b'\n') {
            self.line += 1;
        }
        self.offset += 1;
    }

    /// White space and comments.
    fn skip_blanks(&mut self) -> Result<(), Fault> {
        loop {
            match self.peek() {
                Some(b) if b.is_ascii_whitespace() || b == 0 => self.advance(),
                Some(0xEF) if self.rest().starts_with(b"\xEF\xBB\xBF") => self.offset += 3,
                Some(b'/') if self.rest().starts_with(b"/*") => {
                    let line = self.line;
                    while !self.rest().starts_with(b"*/") {
                        if self.peek().is_none() {
                            return Err(Fault::at_line(line, "a comment without end"));
                        }
                        self.advance();
                    }
                    self.offset += 2;
                }
                _ => return Ok(()),
            }
        }
    }

    /// `#12`
    fn number_sign(&mut self) -> Result<u64, Fault> {
        let line = self.line;
        self.advance();
        let start = self.offset;
        while self.peek().is_some_and(|b| b.is_ascii_digit()) {
            self.advance();
        }
        let digits = std::str::from_utf8(&self.bytes[start..self.offset]).unwrap_or_default();
        digits.parse().map_err(|_| {
            Fault::at_line(line, format!("#{digits} is not the number of an instance"))
        })
    }

    /// A text in quotes, from the opening to behind the closing one.
    fn quoted(&mut self, quote: u8) -> Option<&'b [u8]> {
        self.advance();
        let start = self.offset;
        loop {
            match self.peek()? {
                b if b == quote => {
                    if self.bytes.get(self.offset + 1) == Some(&quote) {
                        self.offset += 2;
                        continue;
                    }
                    let text = &self.bytes[start..self.offset];
                    self.advance();
                    return Some(text);
                }
                _ => self.advance(),
            }
        }
    }

    /// To behind the next `;`. Gives the names of the records at the top.
    fn statement(&mut self, of: Option<(usize, u64)>) -> Result<Vec<String>, Fault> {
        let start = self.line;
        let cut_off = || {
            let place = of.map_or(format!("line {start}"), |(line, id)| at(line, id));
            Fault::new(place, "the file ends inside this statement: it is cut off")
        };
        let mut names = Vec::new();
        let mut depth = 0_usize;
        let complex = of.is_some() && self.peek() == Some(b'(');
        let top = usize::from(complex);
        loop {
            self.skip_blanks()?;
            match self.peek().ok_or_else(cut_off)? {
                b';' => {
                    self.advance();
                    return Ok(names);
                }
                b'\'' => {
                    self.quoted(b'\'').ok_or_else(cut_off)?;
                }
                b'(' => {
                    depth += 1;
                    self.advance();
                }
                b')' => {
                    depth = depth.saturating_sub(1);
                    self.advance();
                }
                b if of.is_some() && depth == top && (b.is_ascii_alphabetic() || b == b'!') => {
                    names.push(self.word());
                }
                _ => self.advance(),
            }
        }
    }

    fn word(&mut self) -> String {
        let start = self.offset;
        let part = |b: u8| b.is_ascii_alphanumeric() || matches!(b, b'_' | b'-' | b'!');
        while self.peek().is_some_and(part) {
            self.advance();
        }
        String::from_utf8_lossy(&self.bytes[start..self.offset]).to_ascii_uppercase()
    }
}

/// Deepest nesting of lists; real files have three or four.
const DEEPEST: usize = 64;

struct Parse<'b> {
    scan: Scan<'b>,
    line: usize,
    id: u64,
    depth: usize,
}

impl Parse<'_> {
    fn fault(&self, message: impl Into<String>) -> Fault {
        Fault::new(at(self.line, self.id), message)
    }

    fn next(&mut self) -> Result<u8, Fault> {
        self.scan.skip_blanks()?;
        let next = self.scan.peek();
        next.ok_or_else(|| self.fault("the file ends inside this instance"))
    }

    fn records(&mut self) -> Result<Vec<Record>, Fault> {
        if self.next()? != b'(' {
            let record = self.record()?;
            self.end()?;
            return Ok(vec![record]);
        }
        self.scan.advance();
        let mut records = Vec::new();
        while self.next()? != b')' {
            records.push(self.record()?);
        }
        self.scan.advance();
        self.end()?;
        Ok(records)
    }

    fn end(&mut self) -> Result<(), Fault> {
        match self.next()? {
            b';' => Ok(()),
            found => Err(self.fault(format!("found {:?}, expected ;", char::from(found)))),
        }
    }

    fn record(&mut self) -> Result<Record, Fault> {
        let found = self.next()?;
        if !found.is_ascii_alphabetic() && found != b'!' {
            let found = char::from(found);
            return Err(self.fault(format!("found {found:?}, expected the name of an entity")));
        }
        let name = self.scan.word();
        if self.next()? != b'(' {
            return Err(self.fault(format!("{name} has no parameters")));
        }
        let parameters = self.list()?;
        Ok(Record { name, parameters })
    }

    fn list(&mut self) -> Result<Vec<Value>, Fault> {
        self.depth += 1;
        if self.depth > DEEPEST {
            return Err(self.fault(format!("lists are nested more than {DEEPEST} deep")));
        }
        self.scan.advance();
        let mut values = Vec::new();
        if self.next()? == b')' {
            self.scan.advance();
            self.depth -= 1;
            return Ok(values);
        }
        loop {
            values.push(self.value()?);
            match self.next()? {
                b',' => self.scan.advance(),
                b')' => {
                    self.scan.advance();
                    self.depth -= 1;
                    return Ok(values);
                }
                found => {
                    let found = char::from(found);
                    return Err(self.fault(format!("found {found:?}, expected , or )")));
                }
            }
        }
    }

    fn value(&mut self) -> Result<Value, Fault> {
        match self.next()? {
            b'$' => {
                self.scan.advance();
                Ok(Value::Omitted)
            }
            b'*' => {
                self.scan.advance();
                Ok(Value::Derived)
            }
            b'#' => Ok(Value::Reference(self.scan.number_sign()?)),
            b'(' => Ok(Value::List(self.list()?)),
            b'\'' => {
                let text = self.scan.quoted(b'\'');
                let text = text.ok_or_else(|| self.fault("a text without end"))?;
                decode(text).map(Value::Text).map_err(|m| self.fault(m))
            }
            b'"' => {
                let text = self.scan.quoted(b'"');
                let text = text.ok_or_else(|| self.fault("a binary without end"))?;
                Ok(Value::Binary(String::from_utf8_lossy(text).into_owned()))
            }
            b'.' if self.scan.rest().get(1).is_some_and(u8::is_ascii_alphabetic) => {
                self.scan.advance();
                let name = self.scan.word();
                if self.scan.peek() != Some(b'.') {
                    return Err(self.fault(format!(".{name} does not end with a point")));
                }
                self.scan.advance();
                Ok(Value::Enumeration(name))
            }
            b if b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.') => self.number(),
            b if b.is_ascii_alphabetic() || b == b'!' => {
                let word = self.scan.word();
                if self.next()? == b'(' {
                    return Ok(Value::Typed(word, self.list()?));
                }
                Err(self.fault(format!(
                    "found {word}, expected a number, a text or a reference"
                )))
            }
            found => {
                let found = char::from(found);
                Err(self.fault(format!("found {found:?}, expected a parameter")))
            }
        }
    }

    fn number(&mut self) -> Result<Value, Fault> {
        let start = self.scan.offset;
        // Everything up to the next separator belongs to it, so that 1.#QNAN and 0x1F are seen
        // whole.
        let part =
            |b: u8| !b.is_ascii_whitespace() && !matches!(b, b',' | b')' | b'(' | b';' | b'/');
        while self.scan.peek().is_some_and(part) {
            self.scan.advance();
        }
        let text = String::from_utf8_lossy(&self.scan.bytes[start..self.scan.offset]).into_owned();
        let plain = text
            .bytes()
            .all(|b| b.is_ascii_digit() || matches!(b, b'+' | b'-' | b'.' | b'e' | b'E'));
        match text.parse::<f64>() {
            Ok(number) if plain && number.is_finite() => Ok(Value::Number(number)),
            _ => Err(self.fault(format!("{text} is not a finite number"))),
        }
    }
}

/// Undoes the directives in a string (ISO 10303-21, 6.4.3).
fn decode(bytes: &[u8]) -> Result<String, String> {
    // Edition 3 is UTF-8; some programs write Latin-1 instead.
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => text.to_owned(),
        Err(_) => bytes.iter().map(|b| char::from(*b)).collect(),
    };
    let mut out = String::new();
    let mut rest = text.as_str();
    while let Some(at) = rest.find(['\\', '\'']) {
        out.push_str(&rest[..at]);
        rest = &rest[at..];
        if let Some(after) = rest.strip_prefix("''") {
            out.push('\'');
            rest = after;
        } else if let Some(after) = rest.strip_prefix("\\\\") {
            out.push('\\');
            rest = after;
        } else if let Some(after) = rest.strip_prefix("\\S\\") {
            let mut chars = after.chars();
            let low = chars
                .next()
                .filter(char::is_ascii)
                .ok_or("\\S\\ without a character")?;
            out.push(char::from(low as u8 | 0x80));
            rest = chars.as_str();
        } else if let Some(after) = rest.strip_prefix("\\X\\") {
            let digits = after.get(..2).ok_or("\\X\\ without two digits")?;
            let code = u8::from_str_radix(digits, 16).map_err(|_| "\\X\\ without two digits")?;
            out.push(char::from(code));
            rest = &after[2..];
        } else if rest.starts_with("\\X2\\") || rest.starts_with("\\X4\\") {
            let wide = rest.starts_with("\\X4\\");
            let end = rest
                .find("\\X0\\")
                .ok_or("\\X2\\ or \\X4\\ without \\X0\\")?;
            out.push_str(&wide_text(&rest[4..end], wide)?);
            rest = &rest[end + 4..];
        } else if rest.len() >= 4 && rest.starts_with("\\P") && rest.as_bytes()[3] == b'\\' {
            // Chooses a code page for \S\; Latin-1 is what programs use.
            rest = &rest[4..];
        } else {
            // Windows paths are written with single backslashes by several programs.
            out.push_str(&rest[..1]);
            rest = &rest[1..];
        }
    }
    out.push_str(rest);
    // Long texts are wrapped at the line's end.
    Ok(out.replace(['\n', '\r'], ""))
}

fn wide_text(digits: &str, wide: bool) -> Result<String, String> {
    let bad = || format!("{digits:?} are not the digits of characters");
    let size = if wide { 8 } else { 4 };
    if !digits.is_ascii() || !digits.len().is_multiple_of(size) {
        return Err(bad());
    }
    let codes: Option<Vec<u32>> = (0..digits.len() / size)
        .map(|i| u32::from_str_radix(&digits[i * size..(i + 1) * size], 16).ok())
        .collect();
    let codes = codes.ok_or_else(bad)?;
    if wide {
        let text: Option<String> = codes.into_iter().map(char::from_u32).collect();
        return text.ok_or_else(bad);
    }
    let units: Vec<u16> = codes.into_iter().map(|code| code as u16).collect();
    String::from_utf16(&units).map_err(|_| bad())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(data: &str) -> String {
        format!("ISO-10303-21;\nHEADER;\nENDSEC;\nDATA;\n{data}\nENDSEC;\nEND-ISO-10303-21;\n")
    }

    fn one(data: &str) -> Result<Instance, Fault> {
        let text = file(data);
        Exchange::index(text.as_bytes()).and_then(|exchange| exchange.instance(1))
    }

    #[test]
    fn every_kind_of_parameter() {
        let instance = one(
            "#1 = /* a; ( comment */ POINT('it''s; a \\X2\\00E400DF\\X0\\ \\S\\d \\X\\41 C:\\\\x', $,*,\n\
             (1., -2.5E-3,+.5,7), .MILLI., \"0F\", LENGTH_MEASURE(25.4), #22, ());",
        )
        .unwrap();
        let record = &instance.records[0];
        assert_eq!((record.name.as_str(), instance.line), ("POINT", 5));
        let number = Value::Number;
        let expected = [
            Value::Text("it's; a äß ä A C:\\x".into()),
            Value::Omitted,
            Value::Derived,
            Value::List(vec![number(1.0), number(-2.5e-3), number(0.5), number(7.0)]),
            Value::Enumeration("MILLI".into()),
            Value::Binary("0F".into()),
            Value::Typed("LENGTH_MEASURE".into(), vec![number(25.4)]),
            Value::Reference(22),
            Value::List(vec![]),
        ];
        assert_eq!(record.parameters, expected);
    }

    #[test]
    fn complex_instances_and_their_names() {
        let text =
            file("#1=(LENGTH_UNIT()NAMED_UNIT(*)SI_UNIT(.MILLI.,.METRE.));\n#20=FACE('A(',#1);");
        let exchange = Exchange::index(text.as_bytes()).unwrap();
        assert_eq!(exchange.named("SI_UNIT"), [1]);
        assert_eq!(exchange.named("FACE"), [20]);
        let unit = exchange.instance(1).unwrap();
        assert_eq!(unit.records.len(), 3);
        assert!(unit.record("NAMED_UNIT").is_some());
    }

    #[test]
    fn damage_is_named_with_its_place() {
        let check = |data: &str, expected: &str| {
            let fault = one(data).unwrap_err().to_string();
            assert!(fault.starts_with(expected), "{data}: {fault}");
        };
        check("#1=P(NaN);", "line 5, #1: found NAN, expected a number");
        check(
            "#1=P(1.#QNAN);",
            "line 5, #1: 1.#QNAN is not a finite number",
        );
        check("#1=P(1e999);", "line 5, #1: 1e999 is not a finite number");
        check("#1=P(1;", "line 5, #1: found ';', expected , or )");
        check("#1=P 1;", "line 5, #1: P has no parameters");
        check(
            "#1=P(1);\n#1=P(2);",
            "line 6, #1: #1 is there already, on line 5",
        );
        check("#2=P(1);", "#1: is referred to and not in the file");
        check(
            "#1=P('\\X2\\00E\\X0\\');",
            "line 5, #1: \"00E\" are not the digits",
        );
        let deep = format!("#1=P({}{});", "(".repeat(99), ")".repeat(99));
        check(&deep, "line 5, #1: lists are nested");

        let whole = file("#1=P('abc',(1.,2.));");
        for cut in 1..whole.len() - 2 {
            let fault = Exchange::index(&whole.as_bytes()[..cut]);
            assert!(fault.is_err(), "cut at {cut}");
        }
        assert!(
            Exchange::index(b"solid cube")
                .unwrap_err()
                .message
                .contains("no STEP file")
        );
    }
}
