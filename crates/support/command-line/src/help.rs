//! What the help of each option has to say: the words that it takes, and the unit of a number.
//!
//! [`check`] is for the tests of programs. The words are listed by clap itself, as long as it knows
//! them ([`clap::builder::TypedValueParser::possible_values`]) and nobody hides them.

use std::any::TypeId;
use std::num::{NonZeroU32, NonZeroU64, NonZeroUsize};

use clap::{Arg, Command};

/// Names of values that say what a number is: `N` is a count or another plain number, `X` a factor;
/// the others are units.
const UNITS: [&str; 12] = [
    "N", "X", "DB", "SECONDS", "MS", "US", "HZ", "MM", "MB", "DEGREES", "PERCENT", "PIXELS",
];

/// Units as help texts write them.
const WORDS: [&str; 9] = [
    "seconds",
    "milliseconds",
    "microseconds",
    "metres",
    "millimetres",
    "degrees",
    "percent",
    "pixels",
    "Hz",
];

/// What is wrong with the helps of a program, one line each: options that take one of some words
/// and do not list them, and options that take a number and do not name its unit.
pub fn check(command: &Command) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut command = command.clone();
    command.build();
    visit(&command, &mut wrong);
    wrong
}

fn visit(command: &Command, wrong: &mut Vec<String>) {
    for verb in command.get_subcommands() {
        visit(verb, wrong);
    }
    let short = joined(&command.clone().render_help().to_string());
    let long = joined(&command.clone().render_long_help().to_string());
    let takes_values = |arg: &&Arg| arg.get_action().takes_values() && !arg.is_hide_set();
    for arg in command.get_arguments().filter(takes_values) {
        let option = format!("{} {}", command.get_name(), arg.get_id());
        let values = arg.get_possible_values();
        let values = values.iter().filter(|value| !value.is_hide_set());
        let names: Vec<&str> = values.map(|value| value.get_name()).collect();
        let list = format!("[possible values: {}]", names.join(", "));
        let is_listed = short.contains(&list) && names.iter().all(|name| long.contains(name));
        if !names.is_empty() && !is_listed {
            wrong.push(format!("{option}: its help does not list {list}"));
        }
        if is_number(arg) && !names_unit(arg) {
            wrong.push(format!("{option}: its help does not name the unit"));
        }
    }
}

/// A text in one line.
fn joined(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

fn is_number(arg: &Arg) -> bool {
    let value = arg.get_value_parser().type_id();
    let numbers = [
        TypeId::of::<f32>(),
        TypeId::of::<f64>(),
        TypeId::of::<i32>(),
        TypeId::of::<i64>(),
        TypeId::of::<u8>(),
        TypeId::of::<u16>(),
        TypeId::of::<u32>(),
        TypeId::of::<u64>(),
        TypeId::of::<usize>(),
        TypeId::of::<NonZeroU32>(),
        TypeId::of::<NonZeroU64>(),
        TypeId::of::<NonZeroUsize>(),
        // WIDTHxHEIGHT
        TypeId::of::<(u32, u32)>(),
        TypeId::of::<[u32; 2]>(),
        // CAMERA=NUMBER
        TypeId::of::<(String, f64)>(),
        TypeId::of::<(Option<String>, f64)>(),
    ];
    numbers.into_iter().any(|number| value == number)
}

fn names_unit(arg: &Arg) -> bool {
    let names = arg.get_value_names().unwrap_or_default();
    // As in `CAMERA=MS`, `[CAMERA=]US`.
    let name = names.last().map_or("", |name| name.as_str());
    let unit = name.rsplit(['=', ']']).next().unwrap_or_default();
    let help = [arg.get_help(), arg.get_long_help()];
    let mut texts = help.iter().flatten().map(ToString::to_string);
    let is_unit = |word: &str| WORDS.contains(&word);
    UNITS.contains(&unit) || texts.any(|text| text.split(|c: char| !c.is_alphabetic()).any(is_unit))
}

#[cfg(test)]
mod tests {
    use clap::builder::PossibleValuesParser;
    use clap::value_parser;

    use super::*;

    fn option(name: &'static str) -> Arg {
        Arg::new(name).long(name)
    }

    fn wrong(arg: Arg) -> Vec<String> {
        check(&Command::new("tool").subcommand(Command::new("go").arg(arg)))
    }

    #[test]
    fn words_are_listed() {
        let words = || option("way").value_parser(PossibleValuesParser::new(["left", "right"]));
        assert_eq!(wrong(words()), [""; 0]);
        let hidden = wrong(words().hide_possible_values(true));
        let list = "go way: its help does not list [possible values: left, right]";
        assert_eq!(hidden, [list]);
    }

    #[test]
    fn numbers_have_units() {
        let number = || option("length").value_parser(value_parser!(f64));
        let none = "go length: its help does not name the unit";
        assert_eq!(wrong(number()), [none]);
        assert_eq!(wrong(number().value_name("LENGTH").help("How far")), [none]);
        assert_eq!(wrong(number().value_name("MM")), [""; 0]);
        assert_eq!(wrong(number().help("How far, metres")), [""; 0]);
        let late = |text: &str| match text.split_once('=') {
            Some((name, ms)) => Ok((name.to_owned(), ms.parse::<f64>().unwrap_or(0.0))),
            None => Err("expected CAMERA=MS".to_owned()),
        };
        let late = option("late").value_parser(late);
        assert_eq!(wrong(late.clone().value_name("CAMERA=MS")), [""; 0]);
        assert_eq!(wrong(late.value_name("CAMERA=LATE")).len(), 1);
    }
}
