//! A module of the library uses only modules above it in `lib.rs`.

use std::fs;
use std::path::{Path, PathBuf};

fn rust_files(folder: &Path, found: &mut Vec<PathBuf>) {
    let mut entries: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            rust_files(&path, found);
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
}

/// Every `crate::name` that `text` mentions outside comments, also in (nested) lists.
fn used_modules(text: &str) -> Vec<String> {
    let code: String = text.lines().map(|l| l.split("//").next().unwrap_or("").to_string() + "\n").collect();
    let name_at = |rest: &str| -> String {
        rest.trim_start().chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect()
    };
    let mut used = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        let Some(list) = rest.strip_prefix('{') else {
            used.push(name_at(rest));
            continue;
        };
        let mut depth = 0;
        let mut starts = vec![0];
        for (i, c) in list.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth == 0 => break,
                '}' => depth -= 1,
                ',' if depth == 0 => starts.push(i + 1),
                _ => {}
            }
        }
        used.extend(starts.into_iter().map(|i| name_at(&list[i..])).filter(|n| !n.is_empty()));
    }
    used
}

fn violations(source: &Path) -> Vec<String> {
    let lib = fs::read_to_string(source.join("lib.rs")).unwrap();
    let order: Vec<&str> =
        lib.lines().filter_map(|l| l.strip_prefix("pub mod ")?.strip_suffix(';')).collect();
    assert!(order.len() > 5, "lib.rs lists the modules as `pub mod name;` lines");
    let mut found = Vec::new();
    for (rank, module) in order.iter().enumerate() {
        let mut files = Vec::new();
        let single = source.join(format!("{module}.rs"));
        if single.exists() {
            files.push(single);
        }
        if source.join(module).is_dir() {
            rust_files(&source.join(module), &mut files);
        }
        assert!(!files.is_empty(), "module {module} has a file");
        for file in files {
            for used in used_modules(&fs::read_to_string(&file).unwrap()) {
                match order.iter().position(|m| *m == used) {
                    Some(other) if other > rank => {
                        found.push(format!("{} uses `{used}`, which lib.rs lists below", file.display()));
                    }
                    Some(_) => {}
                    None => found.push(format!("{} uses unknown module `{used}`", file.display())),
                }
            }
        }
    }
    found
}

#[test]
fn modules_use_only_modules_above_them() {
    let found = violations(&Path::new(env!("CARGO_MANIFEST_DIR")).join("src"));
    assert!(found.is_empty(), "{}", found.join("\n"));
}

#[test]
fn an_upward_use_is_found() {
    assert_eq!(
        used_modules("use crate::{\n    world::{World, Report},\n    math::Aabb,\n};"),
        ["world", "math"]
    );
    assert_eq!(used_modules("let x = crate::scene::load(); // crate::no"), ["scene"]);
}
