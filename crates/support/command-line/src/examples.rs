//! Examples at the end of each verb's help.
//!
//! A program keeps one [`Table`] of them and gives it to [`add`]; [`check`] is for its tests: every
//! verb has examples, and the program takes each of them for that verb.

use clap::Command;

/// What stands above the examples in a help text.
pub const HEADING: &str = "Examples:";

/// One verb: the words of it with spaces between, as in `calib imu`; then its command lines, each
/// with what it does. Words of a command line that have spaces stand in `'` quotes.
pub type Verb = (&'static str, &'static [(&'static str, &'static str)]);

/// All verbs of a program.
pub type Table = &'static [Verb];

/// The command with the examples behind its verbs' help.
pub fn add(mut command: Command, table: Table) -> Command {
    for (verb, examples) in table {
        let words: Vec<&str> = verb.split(' ').collect();
        command = at(command, &words, examples);
    }
    command
}

fn at(command: Command, words: &[&str], examples: &[(&str, &str)]) -> Command {
    let Some((first, rest)) = words.split_first() else {
        let before = command.get_after_help().map(ToString::to_string);
        let before = before.map_or(String::new(), |text| format!("{text}\n\n"));
        return command.after_help(format!("{before}{}", text(examples)));
    };
    command.mut_subcommand(*first, |sub| at(sub, rest, examples))
}

fn text(examples: &[(&str, &str)]) -> String {
    let mut text = HEADING.to_owned();
    for (line, what) in examples {
        text.push_str(&format!("\n  # {what}\n  {line}"));
    }
    text
}

/// What is wrong with the examples of a program, one line each: verbs without examples, and command
/// lines that the program refuses or takes for something else.
pub fn check(command: &Command) -> Vec<String> {
    let mut wrong = Vec::new();
    let mut command = command.clone();
    command.build();
    visit(&command, &command, &mut Vec::new(), &mut wrong);
    wrong
}

fn visit<'a>(
    program: &Command,
    command: &'a Command,
    path: &mut Vec<&'a str>,
    wrong: &mut Vec<String>,
) {
    let verbs = command.get_subcommands().filter(|c| c.get_name() != "help");
    let mut is_verb = !path.is_empty();
    for verb in verbs {
        is_verb = false;
        path.push(verb.get_name());
        visit(program, verb, path, wrong);
        path.pop();
    }
    if !is_verb {
        return;
    }
    let help = command.get_after_help().map(ToString::to_string);
    let help = help.unwrap_or_default();
    let lines = help.lines().skip_while(|line| *line != HEADING).skip(1);
    let mut count = 0;
    for line in lines.map(str::trim).filter(|line| !line.starts_with('#')) {
        count += 1;
        let words = split(line);
        match program.clone().try_get_matches_from(&words) {
            Err(error) => wrong.push(format!("{line}: {error}")),
            Ok(matches) => {
                let mut matches = &matches;
                let mut found = Vec::new();
                while let Some((verb, inner)) = matches.subcommand() {
                    found.push(verb);
                    matches = inner;
                }
                if found != *path {
                    wrong.push(format!(
                        "{line}: an example of {path:?}, taken for {found:?}"
                    ));
                }
            }
        }
    }
    if count == 0 {
        wrong.push(format!("{path:?} has no examples"));
    }
}

/// The words of a command line; what stands between `'` quotes is one word.
fn split(line: &str) -> Vec<String> {
    let mut words = Vec::new();
    for (i, part) in line.split('\'').enumerate() {
        match i % 2 {
            0 => words.extend(part.split_whitespace().map(str::to_owned)),
            _ => words.push(part.to_owned()),
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use clap::{Arg, Command};

    use super::*;

    fn program() -> Command {
        let go = Command::new("go").arg(Arg::new("where").required(true));
        let sub = Command::new("calib").subcommand(Command::new("imu").after_help("Slow."));
        Command::new("tool").subcommand(go).subcommand(sub)
    }

    #[test]
    fn examples_stand_at_the_end_of_the_help_and_are_tried() {
        let table: Table = &[
            ("go", &[("tool go 'a place'", "somewhere")]),
            ("calib imu", &[("tool calib imu", "noise")]),
        ];
        let mut good = add(program(), table);
        assert_eq!(check(&good), [""; 0]);
        let error = good.try_get_matches_from_mut(["tool", "go", "--help"]);
        let help = error.expect_err("help").to_string();
        assert!(
            help.ends_with("Examples:\n  # somewhere\n  tool go 'a place'\n"),
            "{help}"
        );
        let imu = good
            .find_subcommand("calib")
            .unwrap()
            .find_subcommand("imu");
        let imu = imu.unwrap().get_after_help().unwrap().to_string();
        assert!(imu.starts_with("Slow.\n\nExamples:\n"), "{imu}");
    }

    #[test]
    fn what_is_wrong_with_examples_is_found() {
        let wrong = check(&add(program(), &[("go", &[("tool go", "nowhere")])]));
        assert_eq!(wrong.len(), 2, "{wrong:?}");
        let says = |part: &str| wrong.iter().any(|line| line.contains(part));
        assert!(says("required"), "{wrong:?}");
        assert!(says("[\"calib\", \"imu\"] has no examples"), "{wrong:?}");
        let table: Table = &[
            ("go", &[("tool calib imu", "another verb")]),
            ("calib imu", &[("tool calib imu", "noise")]),
        ];
        let wrong = check(&add(program(), table));
        assert!(wrong[0].contains("taken for"), "{wrong:?}");
    }
}
