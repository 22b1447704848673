//! Which file of a crate uses which: a graph out of `use` trees and paths.
//!
//! A path is followed through modules and re-exports to the file that defines what it names, as far
//! as names determine that: a path through a macro or an associated type ends at the file in which
//! it was last known. `mod x;` is no use, code for tests is left out, and other crates are no files
//! of this one.

use std::collections::{BTreeMap, HashMap};

use super::files::folder;
use super::outline::{Outline, Scope};
use super::test_code::module_folder;

/// A file of a crate with what it says about modules.
pub(crate) struct ModuleFile<'a> {
    /// Path from the repository root.
    pub(crate) path: &'a str,
    pub(crate) outline: &'a Outline,
}

/// One file uses another: indices of the files, and the first line that does.
pub(crate) type Edges = BTreeMap<(usize, usize), usize>;

/// The uses among the files of one package. `source` is the folder of its source files,
/// `calib/src`.
pub(crate) fn edges(source: &str, files: &[ModuleFile<'_>]) -> Edges {
    let by_path: HashMap<&str, usize> = files
        .iter()
        .enumerate()
        .map(|(at, file)| (file.path, at))
        .collect();
    let mut taken = vec![false; files.len()];
    let mut edges = Edges::new();
    let mut roots: Vec<usize> = (0..files.len())
        .filter(|at| is_root(files[*at].path, source))
        .collect();
    // A module that the library and a program share is the library's.
    roots.sort_by_key(|at| !files[*at].path.ends_with("/lib.rs"));
    for root in roots {
        if taken[root] {
            continue;
        }
        let mut tree = Tree {
            files,
            modules: Vec::new(),
            edges: &mut edges,
        };
        tree.add_file(root, None, &by_path, &mut taken);
        tree.place_exported_macros();
        for module in 0..tree.modules.len() {
            tree.uses_of(module);
        }
    }
    edges
}

/// Whether a crate begins with this file.
fn is_root(path: &str, source: &str) -> bool {
    let Some(inside) = path
        .strip_prefix(source)
        .and_then(|rest| rest.strip_prefix('/'))
    else {
        return false;
    };
    let program = inside.strip_prefix("bin/");
    matches!(inside, "lib.rs" | "main.rs")
        || program.is_some_and(|rest| !rest.contains('/'))
        || program.is_some_and(|rest| rest.ends_with("/main.rs") && rest.matches('/').count() == 1)
}

/// The modules of one crate.
struct Tree<'a> {
    files: &'a [ModuleFile<'a>],
    modules: Vec<Module<'a>>,
    edges: &'a mut Edges,
}

struct Module<'a> {
    file: usize,
    scope: &'a Scope,
    /// `None` for the root of the crate, which is the first module.
    parent: Option<usize>,
    children: HashMap<&'a str, usize>,
    /// Exported macros of the crate, with their files; at the root only.
    macros: HashMap<&'a str, usize>,
}

/// What a path names.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Target {
    Module(usize),
    /// Something else, in this file.
    Item(usize),
}

/// How many imports a name may go through; more is a circle of imports.
const MAX_IMPORTS: usize = 10;

impl<'a> Tree<'a> {
    fn add_file(
        &mut self,
        file: usize,
        parent: Option<usize>,
        by_path: &HashMap<&str, usize>,
        taken: &mut [bool],
    ) -> usize {
        taken[file] = true;
        let files = self.files;
        let scopes = &files[file].outline.scopes;
        let first = self.modules.len();
        let mut ids: Vec<usize> = Vec::new();
        let mut folders: Vec<String> = Vec::new();
        for scope in scopes {
            let id = self.modules.len();
            let (above, inside) = match scope.parent {
                None => (parent, module_folder(files[file].path)),
                Some(above) => (
                    Some(ids[above]),
                    format!("{}/{}", folders[above], scope.name),
                ),
            };
            self.modules.push(Module {
                file,
                scope,
                parent: above,
                children: HashMap::new(),
                macros: HashMap::new(),
            });
            if let (Some(above), Some(_)) = (above, scope.parent) {
                self.modules[above].children.insert(&scope.name, id);
            }
            ids.push(id);
            folders.push(inside);
        }
        for (at, scope) in scopes.iter().enumerate() {
            for name in &scope.declared {
                let stem = format!("{}/{name}", folders[at]);
                let candidates = [format!("{stem}.rs"), format!("{stem}/mod.rs")];
                let mut found = candidates
                    .iter()
                    .filter_map(|path| by_path.get(path.as_str()));
                if let Some(child) = found.find(|child| !taken[**child]) {
                    let id = self.add_file(*child, Some(ids[at]), by_path, taken);
                    self.modules[ids[at]].children.insert(name, id);
                }
            }
        }
        first
    }

    /// Exported macros lie in the root, wherever they are written.
    fn place_exported_macros(&mut self) {
        let files = self.files;
        let mut macros = HashMap::new();
        for module in &self.modules {
            for name in &files[module.file].outline.exported_macros {
                macros.insert(name.as_str(), module.file);
            }
        }
        if let Some(root) = self.modules.first_mut() {
            root.macros = macros;
        }
    }

    /// Notes every use by a module.
    fn uses_of(&mut self, module: usize) {
        let scope = self.modules[module].scope;
        // Modules that are imported by name: the paths through that name are the uses.
        let mut imported: Vec<(&str, usize, usize, bool)> = Vec::new();
        for import in &scope.imports {
            let target = self.resolve(module, &import.path, 0);
            match (target, &import.name) {
                (Some(Target::Module(to)), None) => self.uses_of_all(module, to, import.line),
                (Some(Target::Module(to)), Some(name)) => {
                    imported.push((name, to, import.line, false));
                }
                (Some(Target::Item(file)), _) => self.note(module, file, import.line),
                (None, _) => {}
            }
        }
        for path in &scope.paths {
            let through = imported
                .iter_mut()
                .find(|(name, ..)| *name == path.parts[0]);
            if let Some((.., is_used)) = through {
                *is_used = true;
            }
            match self.resolve(module, &path.parts, 0) {
                Some(Target::Item(file)) => self.note(module, file, path.line),
                Some(Target::Module(to)) => self.note(module, self.modules[to].file, path.line),
                None => {}
            }
        }
        for (_, to, line, is_used) in imported {
            if !is_used {
                self.note(module, self.modules[to].file, line);
            }
        }
    }

    /// Notes the uses of the names that an import of all brings in. An import of all that brings in
    /// none which the file has is no use.
    fn uses_of_all(&mut self, module: usize, of: usize, line: usize) {
        let own = self.modules[module].scope;
        let file = self.modules[module].file;
        let files = self.files;
        for name in &files[file].outline.names {
            let is_own = own.items.contains(name)
                || self.modules[module].children.contains_key(name.as_str())
                || own.imports.iter().any(|i| i.name.as_ref() == Some(name));
            if is_own {
                continue;
            }
            match self.lookup(of, name, true, false, 0) {
                Some(Target::Item(file)) => self.note(module, file, line),
                Some(Target::Module(to)) => self.note(module, self.modules[to].file, line),
                None => {}
            }
        }
    }

    fn note(&mut self, module: usize, to: usize, line: usize) {
        let from = self.modules[module].file;
        if from != to {
            let first = self.edges.entry((from, to)).or_insert(line);
            *first = line.min(*first);
        }
    }

    /// What a path names that stands in a module; `None` for what other crates define.
    fn resolve(&self, from: usize, path: &[String], imports: usize) -> Option<Target> {
        if imports > MAX_IMPORTS {
            return None;
        }
        let (first, rest) = path.split_first()?;
        let mut target = match first.as_str() {
            "crate" => Target::Module(0),
            "self" => Target::Module(from),
            "super" => Target::Module(self.modules[from].parent?),
            name => self.lookup(from, name, rest.is_empty(), true, imports)?,
        };
        for (at, name) in rest.iter().enumerate() {
            let Target::Module(module) = target else {
                // A variant, or something that belongs to a type.
                return Some(target);
            };
            target = match name.as_str() {
                "super" => Target::Module(self.modules[module].parent?),
                "self" => target,
                name => {
                    let is_last = at + 1 == rest.len();
                    let found = self.lookup(module, name, is_last, false, imports);
                    // Made by a macro, or taken from another crate.
                    found.unwrap_or(Target::Item(self.modules[module].file))
                }
            };
        }
        Some(target)
    }

    /// What a name is in a module. `is_own`: seen from inside, with what functions import for
    /// themselves.
    fn lookup(
        &self,
        module: usize,
        name: &str,
        is_last: bool,
        is_own: bool,
        imports: usize,
    ) -> Option<Target> {
        let Module {
            file,
            scope,
            children,
            macros,
            ..
        } = &self.modules[module];
        let child = children.get(name).map(|child| Target::Module(*child));
        if child.is_some() && !is_last {
            return child;
        }
        if scope.items.contains(name) {
            return Some(Target::Item(*file));
        }
        let visible = || {
            let imports = scope.imports.iter();
            imports.filter(|import| is_own || !import.is_local)
        };
        for import in visible().filter(|import| import.name.as_deref() == Some(name)) {
            let target = self.resolve(module, &import.path, imports + 1);
            if target.is_some() {
                return target;
            }
        }
        if child.is_some() {
            return child;
        }
        if let Some(file) = macros.get(name) {
            return Some(Target::Item(*file));
        }
        for import in visible().filter(|import| import.name.is_none()) {
            if let Some(Target::Module(of)) = self.resolve(module, &import.path, imports + 1)
                && of != module
                && let Some(target) = self.lookup(of, name, is_last, false, imports + 1)
            {
                return Some(target);
            }
        }
        None
    }
}

/// A path without the folder of its source files, for lists.
pub(crate) fn short<'a>(path: &'a str, source: &str) -> &'a str {
    let inside = path.strip_prefix(source).unwrap_or(path);
    inside.strip_prefix('/').unwrap_or(inside)
}

/// The folder of the source files of a package.
pub(crate) fn source_folder(package: &str) -> String {
    format!("{package}/src")
}

/// Whether a file is one of the sources of a package and not of a package inside its folder.
pub(crate) fn is_source(path: &str, source: &str) -> bool {
    let folder = folder(path);
    folder == source
        || folder
            .strip_prefix(source)
            .is_some_and(|rest| rest.starts_with('/'))
}

#[cfg(test)]
mod tests;
