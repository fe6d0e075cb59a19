//! The book and the documents lead where they say: pages, links, and the program's verbs in examples.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

fn workspace() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

fn book() -> PathBuf {
    workspace().join("docs/book/src")
}

fn text_of(file: &Path) -> String {
    fs::read_to_string(file).unwrap_or_else(|error| panic!("{}: {error}", file.display()))
}

/// The Markdown files of a folder, not of those in it.
fn pages_in(folder: &Path) -> Vec<PathBuf> {
    let files = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    let mut pages: Vec<PathBuf> =
        files.filter(|path| path.extension().is_some_and(|extension| extension == "md")).collect();
    pages.sort();
    pages
}

/// The lines of a page, each with whether it is in a code block. The fences themselves are in none.
fn lines_of(text: &str) -> Vec<(&str, bool)> {
    let (mut lines, mut in_code) = (Vec::new(), false);
    for line in text.lines() {
        if line.trim_start().starts_with("```") {
            in_code = !in_code;
        } else {
            lines.push((line, in_code));
        }
    }
    lines
}

/// A line without what stands between backquotes.
fn without_code_spans(line: &str) -> String {
    line.split('`').step_by(2).collect::<Vec<_>>().join(" ")
}

/// Where the links and pictures of a page lead, outside of code: `[text](target)` and `![text](target)`.
fn targets_of(text: &str) -> Vec<String> {
    let mut targets = Vec::new();
    for (line, _) in lines_of(text).into_iter().filter(|(_, in_code)| !in_code) {
        // The text of a link may hold code; its end, `](`, is never in a code span that ends within it.
        let line = without_code_spans(line);
        for (at, _) in line.match_indices("](") {
            let target = line[at + 2..].split(')').next().unwrap_or_default();
            targets.push(target.split_whitespace().next().unwrap_or_default().to_owned());
        }
    }
    targets
}

/// Whether a target is a file beside the page: no address elsewhere, no place within the page.
fn is_of_a_file(target: &str) -> bool {
    !target.contains("://") && !target.starts_with("mailto:") && !target.starts_with('#')
}

/// The relative links of a page that lead to nothing.
fn dead_links(page: &Path) -> Vec<String> {
    let folder = page.parent().unwrap();
    let targets = targets_of(&text_of(page)).into_iter().filter(|target| is_of_a_file(target));
    targets
        .filter(|target| {
            let path = target.split('#').next().unwrap_or_default();
            path.is_empty() || !folder.join(path).exists()
        })
        .collect()
}

/// The verbs that follow `glisson` at the beginning of lines of code blocks, and in code spans.
fn verbs_of(text: &str) -> Vec<String> {
    let mut verbs = Vec::new();
    for (line, in_code) in lines_of(text) {
        let commands: Vec<&str> =
            if in_code { vec![line] } else { line.split('`').skip(1).step_by(2).collect() };
        for command in commands {
            let command = command.trim_start().trim_start_matches("$ ");
            let verb = command.strip_prefix("glisson ").and_then(|rest| rest.split_whitespace().next());
            verbs.extend(verb.filter(|verb| verb.starts_with(char::is_alphabetic)).map(str::to_owned));
        }
    }
    verbs
}

/// `MeshOrgans` as it is typed: `mesh-organs`.
fn typed(variant: &str) -> String {
    let mut name = String::new();
    for c in variant.chars() {
        if c.is_uppercase() && !name.is_empty() {
            name.push('-');
        }
        name.extend(c.to_lowercase());
    }
    name
}

/// The verbs of the program: the variants of its `enum Command`, and `help`, which comes with them.
fn verbs_of_the_program() -> BTreeSet<String> {
    let text = text_of(&workspace().join("crates/glisson-cli/src/commands/mod.rs"));
    let (_, from) = text.split_once("enum Command {").expect("the program has an `enum Command`");
    let variants = from.split_once('}').expect("it ends").0.lines();
    let names = variants.filter_map(|line| line.trim().split_once('(')).map(|(name, _)| typed(name));
    names.chain(["help".to_owned()]).collect()
}

#[test]
fn every_page_is_in_the_summary_and_every_entry_is_a_page() {
    let summary = book().join("SUMMARY.md");
    let entries = targets_of(&text_of(&summary));
    let listed: BTreeSet<PathBuf> = entries.iter().map(|target| book().join(target)).collect();
    assert_eq!(listed.len(), entries.len(), "no page is listed twice");
    let pages: BTreeSet<PathBuf> = pages_in(&book()).into_iter().filter(|page| *page != summary).collect();
    assert!(pages.len() > 5, "the book has pages");
    assert_eq!(listed, pages, "left: listed in SUMMARY.md, right: files");
}

#[test]
fn links_lead_to_files() {
    let root = workspace();
    let named = ["README.md", "ARCHITECTURE.md", "CONTRIBUTING.md"].map(|name| root.join(name));
    let folders = [book(), root.join("docs")];
    let pages = folders.iter().flat_map(|folder| pages_in(folder)).chain(named);
    let mut dead = Vec::new();
    for page in pages {
        dead.extend(dead_links(&page).into_iter().map(|target| format!("{}: {target}", page.display())));
    }
    assert!(dead.is_empty(), "links that lead to nothing:\n{}", dead.join("\n"));
}

#[test]
fn every_picture_of_the_book_is_shown() {
    let texts: String = pages_in(&book()).iter().map(|page| text_of(page)).collect();
    for entry in fs::read_dir(book().join("images")).unwrap() {
        let name = entry.unwrap().file_name().to_string_lossy().into_owned();
        assert!(texts.contains(&format!("(images/{name})")), "no page shows images/{name}");
    }
}

#[test]
fn every_task_is_in_the_surgeons_guide() {
    let guide = text_of(&book().join("surgeons_guide.md"));
    for entry in fs::read_dir(workspace().join("tasks")).unwrap() {
        let name = entry.unwrap().path().file_stem().unwrap().to_string_lossy().into_owned();
        assert!(
            guide.contains(&format!("(`{name}`)")),
            "the table of tasks in surgeons_guide.md lacks `{name}`"
        );
    }
}

#[test]
fn commands_in_the_book_have_verbs_of_the_program() {
    let known = verbs_of_the_program();
    assert!(known.contains("mesh-organs") && known.contains("task"), "{known:?}");
    let mut n_commands = 0;
    for page in pages_in(&book()) {
        for verb in verbs_of(&text_of(&page)) {
            assert!(known.contains(&verb), "{}: `glisson {verb}`: no such verb", page.display());
            n_commands += 1;
        }
    }
    assert!(n_commands > 20, "{n_commands} commands in the book");
}

#[test]
fn dead_links_and_unknown_verbs_are_found() {
    let prose = "[a](b.md) ![c](d.png \"e\") `[no](x)` [f `g`](h.md#i)\nas `glisson task list` or `cargo`\n";
    let page = format!("{prose}```\n[no](y)\n  $ glisson serv z\n```\n");
    assert_eq!(targets_of(&page), ["b.md", "d.png", "h.md#i"]);
    assert_eq!(verbs_of(&page), ["task", "serv"]);
    assert!(is_of_a_file("a.md#b") && !is_of_a_file("#b") && !is_of_a_file("https://a.b/c"));
    assert_eq!(typed("MeshOrgans"), "mesh-organs");
}
