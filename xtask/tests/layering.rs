//! Who may use whom: crates in one direction, modules of a crate only those above them in its `lib.rs`, and no two
//! modules (files) of a crate each other in a circle.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The crates, each of which may use those before it.
const CRATES: [&str; 15] = [
    "glisson-mesh",
    "glisson-tissue",
    "glisson",
    "glisson-runtime",
    "glisson-protocol",
    "glisson-picture",
    "glisson-results",
    "glisson-report",
    "glisson-patient",
    "glisson-net",
    "glisson-view",
    "glisson-lab",
    "glisson-cli",
    "glisson-py",
    "glisson-web",
];

/// The examples stand last, in a folder of their own: they use these crates, as a user would, and no crate uses them.
const EXAMPLES: &str = "glisson-examples";
const USED_BY_EXAMPLES: [&str; 2] = ["glisson", "glisson-runtime"];

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A module of a crate: its path from the crate's root.
type Module = Vec<String>;

/// The source files of a crate by their modules; `lib.rs` and `main.rs` are the root.
fn modules_of(source: &Path) -> BTreeMap<Module, PathBuf> {
    let mut found = BTreeMap::new();
    let mut folders = vec![(source.to_path_buf(), Module::new())];
    while let Some((folder, at)) = folders.pop() {
        for entry in fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let stem = path.file_stem().unwrap().to_string_lossy().into_owned();
            let inner = || at.iter().cloned().chain([stem.clone()]).collect::<Module>();
            if path.is_dir() {
                folders.push((path.clone(), inner()));
            } else if path.extension().is_some_and(|e| e == "rs") {
                let is_root = matches!(stem.as_str(), "mod" | "lib" | "main");
                found.insert(if is_root { at.clone() } else { inner() }, path);
            }
        }
    }
    found
}

/// The code without comments and without the tests at its end.
fn code_of(text: &str) -> String {
    let own = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    own.lines().map(|line| line.split("//").next().unwrap_or_default().to_owned() + "\n").collect()
}

/// The paths of a `use` tree, from its first name on: `a::{b, c::d}` are `a::b` and `a::c::d`.
fn paths_of_tree(tree: &str) -> Vec<Vec<String>> {
    let tree = tree.trim();
    let Some((before, rest)) = tree.split_once('{') else {
        let names = tree.split(" as ").next().unwrap_or_default().split("::");
        return vec![names.map(|name| name.trim().to_owned()).collect()];
    };
    let start: Vec<String> =
        before.split("::").map(str::trim).filter(|name| !name.is_empty()).map(str::to_owned).collect();
    let (mut depth, mut item, mut items) = (0, String::new(), Vec::new());
    for c in rest.chars() {
        match c {
            '}' if depth == 0 => break,
            ',' if depth == 0 => items.push(std::mem::take(&mut item)),
            _ => {
                depth += i32::from(c == '{') - i32::from(c == '}');
                item.push(c);
            }
        }
    }
    items.push(item);
    let inner = items.iter().filter(|item| !item.trim().is_empty()).flat_map(|item| paths_of_tree(item));
    inner.map(|path| start.iter().cloned().chain(path).collect()).collect()
}

/// Every path that code names with `use`, or in place from `crate`, `super` or `self` on.
fn named_paths(code: &str) -> Vec<Vec<String>> {
    let is_name = |c: char| c.is_alphanumeric() || c == '_';
    let mut paths = Vec::new();
    for (at, _) in code.match_indices("use ") {
        if !code[..at].ends_with(is_name) {
            paths.extend(paths_of_tree(code[at + 4..].split(';').next().unwrap_or_default()));
        }
    }
    for start in ["crate::", "super::", "self::"] {
        for (at, _) in code.match_indices(start).filter(|(at, _)| !code[..*at].ends_with(':')) {
            let rest = &code[at..];
            let end = rest.find(|c: char| !is_name(c) && c != ':').unwrap_or(rest.len());
            let names = rest[..end].split("::").filter(|name| !name.is_empty());
            paths.push(names.map(str::to_owned).collect());
        }
    }
    paths
}

/// The module that a path named in `here` leads to, as deep as there are files.
fn module_at(path: &[String], here: &Module, modules: &BTreeMap<Module, PathBuf>) -> Option<Module> {
    let mut names = path.iter().peekable();
    let mut at = match names.peek()?.as_str() {
        "crate" => Module::new(),
        "self" | "super" => here.clone(),
        child => {
            let inner: Module = here.iter().cloned().chain([child.to_owned()]).collect();
            return modules.contains_key(&inner).then_some(inner);
        }
    };
    if path[0] != "super" {
        names.next();
    }
    while names.next_if(|name| *name == "super").is_some() {
        at.pop();
    }
    for name in names {
        at.push(name.clone());
        if !modules.contains_key(&at) {
            at.pop();
            break;
        }
    }
    modules.contains_key(&at).then_some(at)
}

fn is_test(module: &Module) -> bool {
    module.last().is_some_and(|name| name == "tests" || name.ends_with("_tests"))
}

/// Which modules of a crate each one uses. What a module is inside of does not count.
fn uses_of(modules: &BTreeMap<Module, PathBuf>) -> BTreeMap<Module, BTreeSet<Module>> {
    let mut uses = BTreeMap::new();
    for (module, file) in modules.iter().filter(|(module, _)| !is_test(module)) {
        let code = code_of(&fs::read_to_string(file).unwrap());
        let used = named_paths(&code).into_iter().filter_map(|path| module_at(&path, module, modules));
        let used = used.filter(|used| !module.starts_with(used) && !is_test(used));
        uses.insert(module.clone(), used.collect::<BTreeSet<Module>>());
    }
    uses
}

/// Modules that use each other in a circle, directly or through others: one list a circle.
fn circles(uses: &BTreeMap<Module, BTreeSet<Module>>) -> Vec<Vec<Module>> {
    let reached = |from: &Module| {
        let (mut seen, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(module) = open.pop() {
            for next in uses.get(module).into_iter().flatten() {
                if seen.insert(next.clone()) {
                    open.push(next);
                }
            }
        }
        seen
    };
    let reach: BTreeMap<&Module, BTreeSet<Module>> =
        uses.keys().map(|module| (module, reached(module))).collect();
    let mut found: BTreeSet<Vec<Module>> = BTreeSet::new();
    for (module, reached) in &reach {
        if reached.contains(*module) {
            let with =
                reach.iter().filter(|(other, back)| reached.contains(**other) && back.contains(*module));
            found.insert(with.map(|(other, _)| (*other).clone()).collect());
        }
    }
    found.into_iter().collect()
}

fn text_of(module: &Module) -> String {
    module.join("::")
}

/// The modules that `lib.rs` or `main.rs` lists, in its order.
fn order_of(source: &Path) -> Vec<String> {
    let root = ["lib.rs", "main.rs"].map(|name| source.join(name)).into_iter().find(|path| path.exists());
    let text = fs::read_to_string(root.expect("a crate has a root")).unwrap();
    let lines = text.lines().filter_map(|line| {
        let line = line.strip_prefix("pub(crate) ").or(line.strip_prefix("pub ")).unwrap_or(line);
        line.strip_prefix("mod ")?.strip_suffix(';').map(str::to_owned)
    });
    lines.filter(|name| !is_test(&vec![name.clone()])).collect()
}

fn source_of(name: &str) -> PathBuf {
    workspace().join("crates").join(name).join("src")
}

/// The first word of each line of a manifest: of those below `[dependencies]` the crate's name.
fn first_words(manifest: &str) -> impl Iterator<Item = &str> {
    manifest.lines().filter_map(|line| line.split(['.', ' ', '=']).next()).filter(|word| !word.is_empty())
}

#[test]
fn crates_use_only_crates_above_them() {
    let mut folders: Vec<String> = fs::read_dir(workspace().join("crates"))
        .unwrap()
        .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
        .collect();
    folders.sort();
    let mut known = CRATES.to_vec();
    known.sort_unstable();
    assert_eq!(folders, known, "a crate has a place in this list");
    for (rank, name) in CRATES.iter().enumerate() {
        let manifest = fs::read_to_string(workspace().join("crates").join(name).join("Cargo.toml")).unwrap();
        for used in first_words(&manifest) {
            assert!(used != EXAMPLES, "{name} depends on {used}, which stands last");
            if let Some(other) = CRATES.iter().position(|known| *known == used) {
                assert!(other < rank, "{name} depends on {used}, which stands below it");
            }
        }
    }
}

#[test]
fn examples_use_the_library_alone() {
    let manifest = fs::read_to_string(workspace().join("examples/Cargo.toml")).unwrap();
    assert!(manifest.contains(&format!("name = \"{EXAMPLES}\"\n")), "{manifest}");
    let (_, dependencies) = manifest.split_once("[dependencies]\n").unwrap();
    let used: Vec<&str> = first_words(dependencies.split("\n[").next().unwrap()).collect();
    assert_eq!(used, USED_BY_EXAMPLES);
    assert_eq!(manifest.matches("dependencies]").count(), 1, "of one kind only: {manifest}");
}

#[test]
fn modules_use_only_modules_above_them() {
    let mut wrong = Vec::new();
    for name in CRATES {
        let (source, modules) = (source_of(name), modules_of(&source_of(name)));
        let order = order_of(&source);
        let rank = |module: &Module| order.iter().position(|known| Some(known) == module.first());
        for (module, used) in uses_of(&modules) {
            for used in used {
                if let (Some(own), Some(other)) = (rank(&module), rank(&used))
                    && other > own
                {
                    let (module, used) = (text_of(&module), text_of(&used));
                    wrong.push(format!("{name}: {module} uses {used}, which its root lists below"));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_two_modules_use_each_other_in_a_circle() {
    let mut wrong = Vec::new();
    for name in CRATES {
        for circle in circles(&uses_of(&modules_of(&source_of(name)))) {
            let texts: Vec<String> = circle.iter().map(text_of).collect();
            wrong.push(format!("{name}: {}", texts.join(", ")));
        }
    }
    assert!(wrong.is_empty(), "circles:\n{}", wrong.join("\n"));
}

#[test]
fn a_circle_and_an_upward_use_are_found() {
    let modules: BTreeMap<Module, PathBuf> = ["", "a", "b", "b::c", "b::c::d", "e"]
        .map(|path| (path.split("::").filter(|n| !n.is_empty()).map(str::to_owned).collect(), PathBuf::new()))
        .into();
    let module = |path: &str| -> Module { path.split("::").map(str::to_owned).collect() };
    let code = code_of("use crate::{b::{self, c::D, c}, e}; // use crate::no\nlet x = super::super::a::f();");
    let used: Vec<String> = named_paths(&code)
        .iter()
        .filter_map(|path| module_at(path, &module("b::c"), &modules))
        .map(|m| text_of(&m))
        .collect();
    // The root is named by the list's beginning.
    assert_eq!(used, ["b", "b::c", "b::c", "e", "", "a"]);
    assert_eq!(module_at(&["d".to_owned()], &module("b::c"), &modules), Some(module("b::c::d")));
    let uses = |pairs: &[(&str, &[&str])]| {
        pairs.iter().map(|(m, used)| (module(m), used.iter().map(|u| module(u)).collect())).collect()
    };
    let straight = uses(&[("a", &[]), ("b", &["a"]), ("e", &["a", "b"])]);
    assert!(circles(&straight).is_empty());
    let round = uses(&[("a", &["e"]), ("b", &["a"]), ("b::c", &[]), ("e", &["b", "b::c"])]);
    assert_eq!(circles(&round), [[module("a"), module("b"), module("e")]]);
}
