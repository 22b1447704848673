//! A structured text file (YAML or JSON) as a tree in which every value has its line, with
//! accessors whose errors name file, line and the full key, for example `cam0.intrinsics[2]`.

use camera_models::CameraModel;

use crate::error::CalibError;
use crate::text::Source;

pub(crate) mod json;
pub(crate) mod yaml;

/// Maximum nesting depth. Calibration files need eight.
const MAX_DEPTH: usize = 32;

/// A value and the line where it begins, from 1.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Node {
    pub(crate) line: usize,
    pub(crate) value: Value,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Value {
    /// A number, a word, or nothing at all.
    Plain(String),
    /// Text in quotes.
    Quoted(String),
    List(Vec<Node>),
    /// In the order of the file, each key once.
    Map(Vec<(String, Node)>),
}

impl Node {
    fn is_null(&self) -> bool {
        matches!(&self.value, Value::Plain(text) if text.is_empty() || text == "null" || text == "~")
    }

    /// Description for messages.
    fn description(&self) -> String {
        match &self.value {
            _ if self.is_null() => "nothing".to_owned(),
            Value::Plain(text) | Value::Quoted(text) => {
                let start: String = text.chars().take(60).collect();
                format!("{start:?}")
            }
            Value::List(items) => format!("a list of {}", items.len()),
            Value::Map(_) => "a block of keys".to_owned(),
        }
    }
}

/// A value in a file and its key.
#[derive(Clone)]
pub(crate) struct At<'a> {
    source: &'a Source,
    node: &'a Node,
    path: String,
}

impl<'a> At<'a> {
    pub(crate) fn root(source: &'a Source, node: &'a Node) -> Self {
        Self {
            source,
            node,
            path: String::new(),
        }
    }

    pub(crate) fn line(&self) -> usize {
        self.node.line
    }

    /// The full key.
    pub(crate) fn path(&self) -> &str {
        &self.path
    }

    /// The value of a key, or of a key in a block (`T_BS.data`); `None` if it is absent or null.
    pub(crate) fn find(&self, key: &str) -> Option<At<'a>> {
        let mut at = self.clone();
        for part in key.split('.') {
            let Value::Map(entries) = &at.node.value else {
                return None;
            };
            let (name, node) = entries.iter().find(|(name, _)| name == part)?;
            at = at.child(node, name);
        }
        (!at.node.is_null()).then_some(at)
    }

    /// The same for a required key.
    pub(crate) fn get(&self, key: &str) -> Result<At<'a>, CalibError> {
        self.find(key).ok_or_else(|| {
            // The keys beside the missing one, not those at the top of the file.
            let above = key.rsplit_once('.').and_then(|(above, _)| self.find(above));
            let beside = above.as_ref().unwrap_or(self);
            let found = match &beside.node.value {
                Value::Map(entries) => {
                    let keys: Vec<&str> = entries.iter().map(|(k, _)| k.as_str()).collect();
                    keys.join(", ")
                }
                _ => beside.node.description(),
            };
            let at = if beside.path.is_empty() {
                found
            } else {
                format!("{found} (line {})", beside.node.line)
            };
            self.source.missing(&self.name_of(key), &at)
        })
    }

    /// The first of several keys that is present.
    pub(crate) fn find_any(&self, keys: &[&str]) -> Option<At<'a>> {
        keys.iter().find_map(|key| self.find(key))
    }

    /// Keys and values of a block, in the order of the file.
    pub(crate) fn entries(&self) -> Result<Vec<(&'a str, At<'a>)>, CalibError> {
        match &self.node.value {
            Value::Map(entries) => Ok(entries
                .iter()
                .map(|(key, node)| (key.as_str(), self.child(node, key)))
                .collect()),
            _ => Err(self.wrong("a block of keys")),
        }
    }

    /// Elements of a list.
    pub(crate) fn items(&self) -> Result<Vec<At<'a>>, CalibError> {
        match &self.node.value {
            Value::List(items) => Ok(items
                .iter()
                .enumerate()
                .map(|(i, node)| Self {
                    source: self.source,
                    node,
                    path: format!("{}[{i}]", self.path),
                })
                .collect()),
            _ => Err(self.wrong("a list in brackets")),
        }
    }

    pub(crate) fn is_list(&self) -> bool {
        matches!(self.node.value, Value::List(_))
    }

    pub(crate) fn text(&self) -> Result<&'a str, CalibError> {
        match &self.node.value {
            Value::Plain(text) | Value::Quoted(text) => Ok(text),
            _ => Err(self.wrong("one word or number")),
        }
    }

    /// A finite number with a decimal point.
    pub(crate) fn number(&self) -> Result<f64, CalibError> {
        let text = self.text()?;
        self.source
            .number_for(self.node.line, text, &format!(" as {}", self.path))
    }

    /// A number above 0.
    pub(crate) fn positive(&self) -> Result<f64, CalibError> {
        match self.number()? {
            number if number > 0.0 => Ok(number),
            _ => Err(self.wrong("a number above 0")),
        }
    }

    /// A number of pixels: whole and above 0. Also as `640.0`, which some programs write.
    pub(crate) fn size(&self) -> Result<u32, CalibError> {
        match self.number()? {
            n if n >= 1.0 && n <= f64::from(1 << 20) && n.fract() == 0.0 => Ok(n as u32),
            _ => Err(self.wrong("a whole number of pixels above 0")),
        }
    }

    /// Width and height, in this order.
    pub(crate) fn sizes(&self) -> Result<[u32; 2], CalibError> {
        match &self.items()?[..] {
            [w, h] => Ok([w.size()?, h.size()?]),
            _ => Err(self.wrong("width and height in brackets")),
        }
    }

    /// All numbers of a list, and of lists inside it, in reading order.
    pub(crate) fn number_list(&self) -> Result<Vec<f64>, CalibError> {
        let mut all = Vec::new();
        for item in self.items()? {
            if item.is_list() {
                all.extend(item.number_list()?);
            } else {
                all.push(item.number()?);
            }
        }
        Ok(all)
    }

    /// Exactly `N` numbers.
    pub(crate) fn numbers<const N: usize>(&self) -> Result<[f64; N], CalibError> {
        let all = self.number_list()?;
        let count = all.len();
        all.try_into().map_err(|_| {
            // 458,654 in a list are two numbers.
            let comma = if count > N && count <= 2 * N {
                " (were decimal commas written?)"
            } else {
                ""
            };
            self.source.unexpected(
                self.node.line,
                &format!("{count} numbers{comma}"),
                &format!("{} with {N} numbers in brackets", self.path),
            )
        })
    }

    /// One of some words.
    pub(crate) fn one_of(&self, known: &[&str]) -> Result<&'a str, CalibError> {
        let text = self.text()?;
        if known.contains(&text) {
            return Ok(text);
        }
        let expected = format!("{} to be {}", self.path, known.join(" or "));
        Err(self
            .source
            .unexpected(self.node.line, &self.node.description(), &expected))
    }

    /// An error about this value.
    pub(crate) fn wrong(&self, expected: &str) -> CalibError {
        self.wrong_because(&self.node.description(), expected)
    }

    /// An error about this value, with a description of what was found.
    pub(crate) fn wrong_because(&self, found: &str, expected: &str) -> CalibError {
        let key = if self.path.is_empty() {
            String::new()
        } else {
            format!(" as {}", self.path)
        };
        self.source
            .unexpected(self.node.line, found, &format!("{expected}{key}"))
    }

    /// An error about values that can be read but are invalid, if there is a reason.
    pub(crate) fn reject_if(&self, reason: Option<String>) -> Result<(), CalibError> {
        reason.map_or(Ok(()), |reason| {
            Err(CalibError::Implausible {
                path: self.source.path.clone(),
                reason: format!("{}: {reason}", self.place()),
            })
        })
    }

    /// The same for intrinsics; for a block of keys the line is that of the invalid parameter.
    pub(crate) fn reject_invalid_model(&self, model: &CameraModel) -> Result<(), CalibError> {
        model.invalid_parameter().map_or(Ok(()), |(name, reason)| {
            let number = self.find(name);
            number.as_ref().unwrap_or(self).reject_if(Some(reason))
        })
    }

    /// Line and key, for messages.
    pub(crate) fn place(&self) -> String {
        format!("line {}: {}", self.node.line, self.path)
    }

    /// Rejects coefficients that are not 0 beside a model (`beside`) that has none.
    pub(crate) fn only_zeros(&self, beside: &str) -> Result<(), CalibError> {
        match self
            .number_list()?
            .into_iter()
            .find(|number| *number != 0.0)
        {
            Some(number) => {
                Err(self.wrong_because(&format!("{number} beside {beside}"), "only zeros"))
            }
            None => Ok(()),
        }
    }

    fn child(&self, node: &'a Node, key: &str) -> Self {
        Self {
            source: self.source,
            node,
            path: self.name_of(key),
        }
    }

    fn name_of(&self, key: &str) -> String {
        if self.path.is_empty() {
            key.to_owned()
        } else {
            format!("{}.{key}", self.path)
        }
    }
}
