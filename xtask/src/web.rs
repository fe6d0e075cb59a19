//! `cargo xtask web`: the simulation for browsers (`crates/glisson-web`), compiled to WebAssembly.
//!
//! By the toolchain itself where it has the target (`rustup target add wasm32-wasip1`). Else, on Debian, by its compiler for browsers, of
//! which the packages are unpacked into `target/web-toolchain` and nothing is installed: it builds the standard library first.

use crate::{command, root, run, setup, target};
use anyhow::{Context, bail, ensure};
use std::path::{Path, PathBuf};
use std::process::Command;

/// With files and a clock, which the page gives it.
const TARGET: &str = "wasm32-wasip1";

/// Vectors, and multiplication with addition in one; the page takes that apart for browsers without it (`web/src/local/unfused.ts`).
const FEATURES: &str = "+simd128,+relaxed-simd";

/// Builds it into `web/wasm`, where the build of the page takes it from.
pub(crate) fn build() -> anyhow::Result<()> {
    let toolchain = Toolchain::find()?;
    let out = root().join("web/wasm");
    std::fs::create_dir_all(&out).with_context(|| format!("{}: cannot make", out.display()))?;
    let built = toolchain.build()?;
    let placed = out.join("glisson.wasm");
    // Also where it is the same: the page's build tells when sources are newer.
    let n_bytes = std::fs::copy(&built, &placed).with_context(|| placed.display().to_string())?;
    println!("{} ({:.2} MB)", placed.display(), n_bytes as f64 / 1e6);
    Ok(())
}

/// What compiles to WebAssembly.
enum Toolchain {
    /// This one.
    Own,
    /// Debian's, unpacked.
    Unpacked { folder: PathBuf, linker: PathBuf },
}

impl Toolchain {
    fn find() -> anyhow::Result<Self> {
        let sysroot = PathBuf::from(said("rustc", &["--print", "sysroot"])?);
        if sysroot.join("lib/rustlib").join(TARGET).join("lib").is_dir() {
            return Ok(Self::Own);
        }
        let advice =
            format!("the simulation for browsers needs the target {TARGET}: rustup target add {TARGET}");
        if !setup::is_there("apt-get") || !setup::is_there("dpkg-deb") {
            bail!("{advice}");
        }
        let host = said("rustc", &["-vV"])?;
        let host =
            host.lines().find_map(|line| line.strip_prefix("host: ")).context("rustc -vV names no host")?;
        let linker = sysroot.join("lib/rustlib").join(host).join("bin/rust-lld");
        ensure!(linker.is_file(), "{advice}; or else a toolchain that has {}", linker.display());
        let folder = unpacked().with_context(|| advice)?;
        Ok(Self::Unpacked { folder, linker })
    }

    /// Compiles; answers where the program is.
    fn build(&self) -> anyhow::Result<PathBuf> {
        let to = target().join("web");
        let mut cargo = command("cargo");
        cargo
            .args(["build", "--profile", "web", "--locked", "--package", "glisson-web", "--target", TARGET])
            .current_dir(root())
            .env("CARGO_TARGET_DIR", &to)
            // They would take the place of those below.
            .env_remove("RUSTFLAGS")
            .env_remove("CARGO_ENCODED_RUSTFLAGS");
        let mut flags = format!("-Ctarget-feature={FEATURES}");
        if let Self::Unpacked { folder, linker } = self {
            let libc = folder.join("usr/lib/wasm32-wasi");
            // Threads are asked for by name alone, and the page says that there are none.
            flags += &format!(
                " -L{libc} -Clink-self-contained=no -Clink-arg={libc}/crt1-reactor.o -Clink-arg=--allow-undefined",
                libc = libc.display()
            );
            cargo
                .arg("-Zbuild-std=std,panic_abort")
                .env("RUSTC", wrapper(folder)?)
                .env("RUSTC_BOOTSTRAP", "1")
                .env("CARGO_TARGET_WASM32_WASIP1_LINKER", linker);
        }
        cargo.env("CARGO_TARGET_WASM32_WASIP1_RUSTFLAGS", flags);
        println!("$ cargo build --profile web --package glisson-web --target {TARGET}");
        let status = cargo.status().context("cannot start cargo")?;
        ensure!(status.success(), "the simulation for browsers does not compile ({status})");
        Ok(to.join(TARGET).join("web/glisson_web.wasm"))
    }
}

/// The first line that a program says, or all of several.
fn said(program: &str, arguments: &[&str]) -> anyhow::Result<String> {
    let output =
        command(program).args(arguments).output().with_context(|| format!("cannot start {program}"))?;
    ensure!(output.status.success(), "`{program} {}` failed ({})", arguments.join(" "), output.status);
    Ok(String::from_utf8_lossy(&output.stdout).trim().to_owned())
}

/// Debian's compiler for browsers with its sources and a C library, in a folder of their own.
fn unpacked() -> anyhow::Result<PathBuf> {
    let folder = target().join("web-toolchain");
    let complete = folder.join("complete");
    if complete.is_file() {
        return Ok(folder);
    }
    std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
    // A new machine knows of no package yet.
    if setup::is_root() {
        run("apt-get", &["update", "-qq"])?;
    }
    let mut packages: Vec<String> =
        ["rustc-web", "libstd-rust-web-dev", "rust-web-src", "wasi-libc"].map(str::to_owned).to_vec();
    // The compiler's libraries, whose names have versions in them, and what these need.
    for _ in 0..2 {
        let names: Vec<&str> = packages.iter().map(String::as_str).collect();
        let depends = said("apt-cache", &[&["depends"], &names[..]].concat())?;
        let needed = |name: &&str| name.starts_with("libllvm") || name.starts_with("libstd-rust-web");
        let found = depends.lines().filter_map(|line| line.trim().strip_prefix("Depends: ")).filter(needed);
        packages.extend(found.map(str::to_owned));
        packages.sort_unstable();
        packages.dedup();
    }
    println!("fetching {} (WebAssembly)", packages.join(", "));
    let status = Command::new("apt-get").arg("download").args(&packages).current_dir(&folder).status()?;
    ensure!(status.success(), "apt-get download {} failed ({status})", packages.join(" "));
    for entry in std::fs::read_dir(&folder)? {
        let package = entry?.path();
        if package.extension().is_some_and(|ending| ending == "deb") {
            let status = Command::new("dpkg-deb").arg("-x").arg(&package).arg(&folder).status()?;
            ensure!(status.success(), "{}: cannot be unpacked ({status})", package.display());
            std::fs::remove_file(&package)?;
        }
    }
    std::fs::write(&complete, "")?;
    Ok(folder)
}

/// Runs the unpacked compiler with its own libraries.
fn wrapper(folder: &Path) -> anyhow::Result<PathBuf> {
    let path = folder.join("rustc.sh");
    let at = folder.display();
    let libraries = format!("{at}/usr/lib/{}-linux-gnu", std::env::consts::ARCH);
    let script = format!("#!/bin/sh\nLD_LIBRARY_PATH={libraries} exec {at}/usr/bin/rustc \"$@\"\n");
    if !std::fs::read_to_string(&path).is_ok_and(|there| there == script) {
        std::fs::write(&path, script).with_context(|| path.display().to_string())?;
        let status = Command::new("chmod").arg("+x").arg(&path).status()?;
        ensure!(status.success(), "{}: cannot be made a program", path.display());
    }
    Ok(path)
}
