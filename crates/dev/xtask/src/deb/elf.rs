//! What a program asks of the system that runs it, and how it is hardened, out of what `readelf`
//! prints. Pure.
//!
//! `readelf` is used because it is there wherever packages are made, and reads programs of every
//! processor.

/// Symbols that are imported without need: the program runs without them.
const WEAK: &str = "WEAK";

/// A function or variable that the program expects in a library.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct Symbol {
    pub(super) name: String,
    /// The version that it must have; `Base` in libraries without versions.
    pub(super) version: String,
    /// Whether the program starts without it.
    pub(super) is_weak: bool,
}

/// What `readelf --wide --dyn-syms` lists as undefined.
///
/// A line is `NUM: VALUE SIZE TYPE BIND VIS NDX NAME@VERSION (NUMBER)`.
pub(super) fn undefined_symbols(listing: &str) -> Vec<Symbol> {
    listing
        .lines()
        .filter_map(|line| {
            let mut words = line.split_whitespace().skip(4);
            let bind = words.next()?;
            let (name, version) = match (words.nth(1)?, words.next()?) {
                ("UND", name) => name.split_once('@').unwrap_or((name, "Base")),
                _ => return None,
            };
            Some(Symbol {
                name: name.to_owned(),
                version: version.to_owned(),
                is_weak: bind == WEAK,
            })
        })
        .collect()
}

/// The libraries that `readelf --wide --dynamic` lists as needed.
pub(super) fn needed_libraries(listing: &str) -> Vec<String> {
    listing
        .lines()
        .filter(|line| line.contains("(NEEDED)"))
        .filter_map(|line| Some(line.split_once('[')?.1.split_once(']')?.0.to_owned()))
        .collect()
}

/// What is wrong with the program beyond its symbols, out of `readelf --wide --file-header
/// --program-headers --section-headers --dynamic`.
pub(super) fn faults(listing: &str) -> Vec<&'static str> {
    let has = |text: &str| listing.contains(text);
    let line = |name: &str| {
        listing
            .lines()
            .find(|line| line.trim_start().starts_with(name))
    };
    let dynamic_flag = |flag: &str| {
        listing
            .lines()
            .filter(|line| line.contains("(FLAGS)") || line.contains("(FLAGS_1)"))
            .any(|line| line.split_whitespace().any(|word| word == flag))
    };
    let checks = [
        (
            has("(RPATH)") || has("(RUNPATH)"),
            "it looks for libraries in a folder of the machine that built it (RPATH)",
        ),
        (
            has(".symtab") || has(".debug_info"),
            "it is not stripped of its symbols",
        ),
        (
            !(has("DYN (") && dynamic_flag("PIE")),
            "it is not position independent (PIE)",
        ),
        (
            !(line("GNU_RELRO").is_some() && (dynamic_flag("BIND_NOW") || dynamic_flag("NOW"))),
            "its tables of addresses stay writable (full RELRO)",
        ),
        (
            !line("GNU_STACK").is_some_and(|line| line.contains(" RW ")),
            "its stack can be executed",
        ),
    ];
    checks
        .into_iter()
        .filter_map(|(wrong, what)| wrong.then_some(what))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_others_must_bring_is_undefined() {
        let listing = "\
Symbol table '.dynsym' contains 4 entries:
   Num:    Value          Size Type    Bind   Vis      Ndx Name
     0: 0000000000000000     0 NOTYPE  LOCAL  DEFAULT  UND 
    11: 0000000000000000     0 FUNC    GLOBAL DEFAULT  UND gst_init
    12: 0000000000000000     0 FUNC    GLOBAL DEFAULT  UND stat@GLIBC_2.33 (3)
    13: 0000000000000000     0 NOTYPE  WEAK   DEFAULT  UND __gmon_start__
    14: 0000000000013a10    20 FUNC    GLOBAL DEFAULT   13 rust_eh_personality
";
        let found: Vec<_> = undefined_symbols(listing)
            .into_iter()
            .map(|symbol| (symbol.name, symbol.version, symbol.is_weak))
            .collect();
        let expected = [
            ("gst_init", "Base", false),
            ("stat", "GLIBC_2.33", false),
            ("__gmon_start__", "Base", true),
        ];
        assert_eq!(
            found,
            expected.map(|(name, version, weak)| (name.to_owned(), version.to_owned(), weak))
        );
    }

    const GOOD: &str = "\
  Type:                              DYN (Position-Independent Executable file)
  [ 1] .dynsym           DYNSYM          00000000000002e0 0002e0 001668 18   A  7   1  8
  GNU_STACK      0x000000 0x0000000000000000 0x0000000000000000 0x000000 0x000000 RW  0x10
  GNU_RELRO      0x1bd5c8 0x00000000001be5c8 0x00000000001be5c8 0x00da38 0x00da38 R   0x1
 0x0000000000000001 (NEEDED)             Shared library: [libgstreamer-1.0.so.0]
 0x0000000000000001 (NEEDED)             Shared library: [libc.so.6]
 0x000000000000001e (FLAGS)              BIND_NOW
 0x000000006ffffffb (FLAGS_1)            Flags: NOW PIE
";

    #[test]
    fn a_hardened_program_has_no_faults() {
        assert_eq!(faults(GOOD), [""; 0]);
        assert_eq!(
            needed_libraries(GOOD),
            ["libgstreamer-1.0.so.0", "libc.so.6"]
        );
    }

    #[test]
    fn each_lack_is_a_fault_of_its_own() {
        for (good, bad, fault) in [
            ("(NEEDED)", "(RUNPATH)", "RPATH"),
            (".dynsym", ".symtab", "stripped"),
            ("NOW PIE", "NOW", "PIE"),
            ("GNU_RELRO", "NOTE", "RELRO"),
            ("RW  0x10", "RWE 0x10", "stack"),
        ] {
            let found = faults(&GOOD.replace(good, bad));
            assert_eq!(found.len(), 1, "{bad}: {found:?}");
            assert!(found[0].contains(fault), "{bad}: {found:?}");
        }
        let lazily_bound = GOOD.replace("BIND_NOW", "").replace("Flags: NOW", "Flags:");
        assert_eq!(faults(&lazily_bound).len(), 1);
    }
}
