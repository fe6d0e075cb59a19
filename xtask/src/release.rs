//! `cargo xtask release`: what is given to users, and the next version's number.

use crate::{build_all, program, python, root, run, run_in, run_within, setup, target, web};
use anyhow::{Context, ensure};
use sha2::{Digest, Sha256};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Duration;

/// Cargo's commands that it needs: their versions are those that were tried.
const TOOLS: [(&str, &str, &[&str]); 3] = [
    ("cargo-about", "0.9.3", &["--features", "cli"]),
    ("cargo-cyclonedx", "0.5.9", &[]),
    ("cargo-deb", "3.8.0", &[]),
];
/// How long compiling one of them may take.
const INSTALLING: Duration = Duration::from_secs(1800);
/// What a version is written into, besides the page's manifest and the lock files.
const FILES_OF_VERSION: [&str; 2] = ["Cargo.toml", "CHANGELOG.md"];
/// What the page brings with it.
const PAGE_LICENCES: [(&str, &str); 2] = [
    ("three", "web/node_modules/three/LICENSE"),
    ("@bjorn3/browser_wasi_shim", "web/node_modules/@bjorn3/browser_wasi_shim/LICENSE-MIT"),
];

/// Where the files are put, wherever cargo builds into: manifests and the Containerfile name it.
fn folder() -> PathBuf {
    root().join("target/release-files")
}

/// Makes all files of a release. With a version its number and the date go into the tree first.
pub(crate) fn make(version: Option<&str>, wheel: bool) -> anyhow::Result<()> {
    let texts = version.map(texts_of_version).transpose()?;
    setup::require_file("/usr/bin/strip", "binutils")?;
    setup::require_file("/usr/bin/dpkg-shlibdeps", "dpkg-dev")?;
    let tools = install()?;
    if let (Some(version), Some(texts)) = (version, texts) {
        set_version(version, &texts)?;
        println!("`cargo xtask release --dry-run` goes on from here, should anything fail");
    }
    let out = folder();
    if out.exists() {
        fs::remove_dir_all(&out).with_context(|| out.display().to_string())?;
    }
    fs::create_dir_all(&out).with_context(|| out.display().to_string())?;
    // With the page of scenes that simulate themselves.
    web::build()?;
    build_all()?;
    licences(&tools, &out)?;
    bill_of_materials(&tools, &out)?;
    container(&out)?;
    let place = format!("{}/", out.display());
    let words = ["deb", "--package", "glisson-cli", "--no-build", "--strip", "--output", &place];
    run(&tool(&tools, "cargo-deb"), &words)?;
    crates(&out, wheel)?;
    if wheel {
        python::wheel()?;
        for entry in fs::read_dir(root().join(target()).join("wheels"))? {
            let entry = entry?;
            fs::copy(entry.path(), out.join(entry.file_name()))?;
        }
    }
    let sums = sums(&out)?;
    fs::write(out.join("SHA256SUMS"), &sums)?;
    println!("\n{sums}\nin {}", out.display());
    Ok(())
}

/// The crates as registries take them; with `checks` each is compiled from what it holds alone.
fn crates(out: &Path, checks: bool) -> anyhow::Result<()> {
    let all =
        ["package", "--workspace", "--exclude", "xtask", "--exclude", "glisson-examples", "--allow-dirty"];
    // Of other versions, and of what is not packaged.
    let made = root().join(target()).join("package");
    if made.exists() {
        fs::remove_dir_all(&made).with_context(|| made.display().to_string())?;
    }
    let pages = root().join("web/dist/index.html");
    ensure!(pages.exists(), "{} is missing: the crate of the pages would have none", pages.display());
    let more: &[&str] = if checks { &[] } else { &["--no-verify"] };
    run("cargo", &[&all[..], more].concat())?;
    for entry in fs::read_dir(&made)? {
        let file = entry?.path();
        if file.extension().is_some_and(|ending| ending == "crate")
            && let Some(name) = file.file_name()
        {
            fs::copy(&file, out.join(name))?;
        }
    }
    Ok(())
}

/// Installs the tools; answers with the folder that has them.
fn install() -> anyhow::Result<PathBuf> {
    let tools = root().join(target()).join("tools");
    for (name, version, features) in TOOLS {
        // One that was installed by an earlier version of this list is another one.
        let stamp = tools.join(format!("{name}-{version}"));
        if !stamp.exists() {
            let named = format!("{name}@{version}");
            let place = tools.to_string_lossy();
            let words = ["install", "--locked", "--force", "--root", &place, &named];
            run_within(INSTALLING, "cargo", &[&words[..], features].concat())?;
            fs::write(&stamp, "")?;
        }
    }
    Ok(tools)
}

fn tool(tools: &Path, name: &str) -> String {
    tools.join("bin").join(name).to_string_lossy().into_owned()
}

/// Texts of the licences of all that is in the program and in the Python package; fails where one is none of those that `about.toml` allows.
fn licences(tools: &Path, out: &Path) -> anyhow::Result<()> {
    let [list, template] = ["licences.md", "xtask/release/licences.hbs"].map(|name| match name {
        "licences.md" => out.join(name),
        _ => root().join(name),
    });
    let [list_name, template] = [&list, &template].map(|path| path.to_string_lossy());
    let config = root().join("xtask/release/about.toml");
    // It has the program in it.
    let manifest = root().join("crates/glisson-py/Cargo.toml");
    let [config, manifest] = [&config, &manifest].map(|path| path.to_string_lossy());
    let words =
        ["about", "generate", "--locked", "--fail", "--config", &config, "--manifest-path", &manifest];
    run(&tool(tools, "cargo-about"), &[&words[..], &["--output-file", &list_name, &template]].concat())?;
    let mut text = fs::read_to_string(&list)?;
    for (name, licence) in PAGE_LICENCES {
        let path = root().join(licence);
        let words = fs::read_to_string(&path).with_context(|| path.display().to_string())?;
        text += &format!("\n## {name} (in the page)\n\n```text\n{}\n```\n", words.trim());
    }
    fs::write(&list, text).with_context(|| list.display().to_string())
}

/// What the program is made of, as CycloneDX.
fn bill_of_materials(tools: &Path, out: &Path) -> anyhow::Result<()> {
    const NAME: &str = "glisson.cdx";
    let manifest = root().join("crates/glisson-cli/Cargo.toml");
    let words = ["cyclonedx", "--manifest-path", &manifest.to_string_lossy(), "--format", "json"];
    let more = ["--target", "x86_64-unknown-linux-gnu", "--override-filename", NAME];
    // Beside each manifest of the workspace; the program's is the one that is wanted.
    run(&tool(tools, "cargo-cyclonedx"), &[&words[..], &more].concat())?;
    let crates = fs::read_dir(root().join("crates"))?.map(|entry| entry.map(|entry| entry.path()));
    let mut members = crates.collect::<Result<Vec<_>, _>>()?;
    members.extend(["examples", "xtask"].map(|name| root().join(name)));
    let mut n_found = 0;
    for member in members {
        let file = member.join(format!("{NAME}.json"));
        if member.ends_with("glisson-cli") && file.exists() {
            fs::copy(&file, out.join(format!("{NAME}.json")))?;
            n_found += 1;
        }
        if file.exists() {
            fs::remove_file(&file)?;
        }
    }
    ensure!(n_found == 1, "cargo-cyclonedx wrote {n_found} bills of materials of the program");
    Ok(())
}

/// The program and the libraries that it is linked to, as the root of a container (Containerfile); tried in it.
fn container(out: &Path) -> anyhow::Result<()> {
    let root_folder = out.join("container");
    let put = |from: &Path, to: &Path| {
        let there = root_folder.join(to.strip_prefix("/").unwrap_or(to));
        fs::create_dir_all(there.parent().context("a folder")?)?;
        fs::copy(from, &there).with_context(|| from.display().to_string()).map(|_| there)
    };
    let program = root().join(program());
    let placed = put(&program, Path::new("/usr/bin/glisson"))?;
    run("strip", &[&placed.to_string_lossy()])?;
    let told = Command::new("ldd").arg(&program).output().context("cannot start ldd")?;
    ensure!(told.status.success(), "ldd does not know what {} is linked to", program.display());
    for line in String::from_utf8_lossy(&told.stdout).lines() {
        if let Some(library) = line.split_whitespace().find(|word| word.starts_with('/')) {
            put(Path::new(library), Path::new(library))?;
        }
    }
    for made in ["tmp", "work"] {
        fs::create_dir_all(root_folder.join(made))?;
        // Whoever it is run as.
        run("chmod", &["1777", &root_folder.join(made).to_string_lossy()])?;
    }
    // What the libraries' packages say of their licences.
    for package in ["libc6", "libgcc-s1"] {
        let copyright = Path::new("/usr/share/doc").join(package).join("copyright");
        if copyright.exists() {
            put(&copyright, &copyright)?;
        }
    }
    for name in ["LICENSE-MIT", "LICENSE-APACHE"] {
        put(&root().join(name), &Path::new("/usr/share/doc/glisson").join(name))?;
    }
    put(&out.join("licences.md"), Path::new("/usr/share/doc/glisson/licences.md"))?;
    println!("the container's root is {}: podman build --file Containerfile", root_folder.display());
    Ok(())
}

fn sums(out: &Path) -> anyhow::Result<String> {
    let mut files: Vec<PathBuf> =
        fs::read_dir(out)?.map(|entry| entry.map(|entry| entry.path())).collect::<Result<_, _>>()?;
    files.retain(|file| file.is_file());
    files.sort();
    let mut text = String::new();
    for file in files {
        let sum = Sha256::digest(fs::read(&file)?);
        let digits: String = sum.iter().map(|byte| format!("{byte:02x}")).collect();
        text += &format!("{digits}  {}\n", file.file_name().unwrap_or_default().to_string_lossy());
    }
    Ok(text)
}

/// The workspace's manifest and the changelog with a version; refused where there is what is not committed.
fn texts_of_version(version: &str) -> anyhow::Result<[String; 2]> {
    let [manifest, changelog] = FILES_OF_VERSION.map(|name| fs::read_to_string(root().join(name)));
    let date = Command::new("date").args(["-u", "+%F"]).output().context("cannot start date")?;
    let date = String::from_utf8_lossy(&date.stdout).trim().to_owned();
    let texts = [with_version(&manifest?, version)?, with_heading(&changelog?, version, &date)?];
    let changed = Command::new("git").args(["status", "--porcelain"]).current_dir(root()).output();
    let changed = changed.context("cannot start git")?.stdout;
    ensure!(changed.is_empty(), "there is what is not committed: a release is made of what is");
    Ok(texts)
}

/// Writes the version into the manifests, and what is unreleased in the changelog under it.
fn set_version(version: &str, texts: &[String; 2]) -> anyhow::Result<()> {
    for (name, text) in FILES_OF_VERSION.iter().zip(texts) {
        fs::write(root().join(name), text).with_context(|| (*name).to_owned())?;
    }
    setup::web_packages()?;
    run_in(
        &root().join("web"),
        "npm",
        &["version", version, "--no-git-tag-version", "--allow-same-version"],
    )?;
    run("cargo", &["update", "--workspace"])?;
    println!("version {version}: look at git diff, commit it, tag it v{version}");
    Ok(())
}

/// Three numbers.
fn numbers_of(version: &str) -> Option<[u64; 3]> {
    let numbers: Vec<u64> = version.split('.').map(str::parse).collect::<Result<_, _>>().ok()?;
    numbers.try_into().ok()
}

/// The workspace's manifest with a later version.
fn with_version(manifest: &str, version: &str) -> anyhow::Result<String> {
    let wanted = numbers_of(version)
        .with_context(|| format!("\"{version}\" is no version; give MAJOR.MINOR.PATCH"))?;
    let at = manifest.find("[workspace.package]").context("Cargo.toml has no [workspace.package]")?;
    let from = at + manifest[at..].find("version = \"").context("no version there")? + "version = \"".len();
    let to = from + manifest[from..].find('"').context("no end of the version")?;
    let current = &manifest[from..to];
    let known = numbers_of(current).with_context(|| format!("the version \"{current}\" of Cargo.toml"))?;
    ensure!(wanted > known, "version {version} is not later than {current}");
    let text = format!("{}{version}{}", &manifest[..from], &manifest[to..]);
    // The crates name each other's version, too.
    let (old, new) = (format!("version = \"{current}\""), format!("version = \"{version}\""));
    let lines = text.split_inclusive('\n');
    Ok(lines
        .map(
            |line| if line.contains("path = \"crates/") { line.replace(&old, &new) } else { line.to_owned() },
        )
        .collect())
}

/// The changelog whose unreleased changes are those of a version.
fn with_heading(changelog: &str, version: &str, date: &str) -> anyhow::Result<String> {
    const UNRELEASED: &str = "## Unreleased\n";
    let at = changelog.find(UNRELEASED).context("CHANGELOG.md has no \"## Unreleased\"")? + UNRELEASED.len();
    let changes = changelog[at..].split("\n## ").next().unwrap_or_default().trim();
    ensure!(!changes.is_empty(), "CHANGELOG.md has nothing under \"## Unreleased\": what is to be released?");
    Ok(format!("{}\n## {version} ({date})\n{}", &changelog[..at], &changelog[at..]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_release_has_a_later_version() {
        let manifest = "[workspace]\n[workspace.package]\nversion = \"0.1.9\"\nedition = \"2024\"\n";
        assert_eq!(with_version(manifest, "0.1.10").unwrap(), manifest.replace("0.1.9", "0.1.10"));
        let with_crates =
            format!("{manifest}a = {{ path = \"crates/a\", version = \"0.1.9\" }}\nb = \"0.1.9\"\n");
        let later = with_version(&with_crates, "0.2.0").unwrap();
        assert!(
            later.ends_with("a = { path = \"crates/a\", version = \"0.2.0\" }\nb = \"0.1.9\"\n"),
            "{later}"
        );
        for wrong in ["0.1.9", "0.0.10", "1.0", "v0.2.0"] {
            assert!(with_version(manifest, wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn what_is_unreleased_gets_the_version() {
        let text =
            with_heading("# C\n\n## Unreleased\n- a\n\n## 0.1.0 (2026-01-01)\n- b\n", "0.2.0", "2026-02-01")
                .unwrap();
        assert_eq!(
            text,
            "# C\n\n## Unreleased\n\n## 0.2.0 (2026-02-01)\n- a\n\n## 0.1.0 (2026-01-01)\n- b\n"
        );
        assert!(with_heading("## Unreleased\n\n## 0.1.0\n- b\n", "0.2.0", "").is_err());
    }
}
