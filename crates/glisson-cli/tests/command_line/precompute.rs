//! `glisson precompute`: interruptions lose nothing, and bad input is told.

use super::{files, glisson, refuses};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// A block of cubes with `n` along each edge, 10 cm wide, as a plain list in mm.
fn block(folder: &Path, n: u32) {
    let place = |i: u32| 100.0 * f64::from(i) / f64::from(n);
    let number = |i: u32, j: u32, k: u32| (i * (n + 1) + j) * (n + 1) + k;
    let (mut nodes, mut tets) = (String::new(), String::new());
    for i in 0..=n {
        for j in 0..=n {
            for k in 0..=n {
                nodes += &format!("{} {} {}\n", place(i), place(j), place(k));
                if i == n || j == n || k == n {
                    continue;
                }
                // Kuhn's six tetrahedra of a cube: a path along the axes in every order.
                for [a, b, c] in [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]] {
                    let step = |axes: &[usize]| {
                        let of = |axis| u32::from(axes.contains(&axis));
                        number(i + of(0), j + of(1), k + of(2))
                    };
                    let [second, third] = [step(&[a, b]), step(&[a])];
                    let is_even = (a + 1) % 3 == b;
                    let [second, third] = if is_even { [third, second] } else { [second, third] };
                    tets += &format!("{} {second} {third} {}\n", step(&[]), step(&[a, b, c]));
                }
            }
        }
    }
    let (n_nodes, n_tets) = ((n + 1).pow(3), 6 * n.pow(3));
    std::fs::write(folder.join("block.tet"), format!("{n_nodes} {n_tets}\n{nodes}{tets}")).unwrap();
}

const HELD: [&str; 4] = ["--tissue", "liver", "--fix-box-mm=-1,-1,-1,101,101,1", "--threads=1"];

fn arguments<'a>(out: &'a str, more: &[&'a str]) -> Vec<&'a str> {
    [&["precompute", "block.tet", "-o", out], &HELD[..], more].concat()
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap()
}

/// Starts, and waits until some of the nodes are in the unfinished file. `None` if it was done too soon to be caught.
fn caught_at_work(folder: &Path, out: &str, at_least_bytes: u64) -> Option<(Child, PathBuf)> {
    let partial = folder.join(format!("{out}.partial"));
    let mut child = Command::new(env!("CARGO_BIN_EXE_glisson"))
        .args(arguments(out, &[]))
        .current_dir(folder)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    loop {
        if std::fs::metadata(&partial).is_ok_and(|m| m.len() > at_least_bytes) {
            return Some((child, partial));
        }
        if child.try_wait().unwrap().is_some() {
            return None;
        }
        std::thread::sleep(Duration::from_micros(200));
    }
}

#[test]
fn a_killed_precomputation_goes_on_where_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    block(path, 8);
    let whole = glisson(path, &arguments("whole", &[]));
    assert!(whole.status.success(), "{}", String::from_utf8_lossy(&whole.stderr));
    let whole = bytes(&path.join("whole"));

    // Killed again and again, each time with more done.
    let mut kills = 0;
    for share in [0.2, 0.4, 0.6] {
        if let Some((mut child, partial)) = caught_at_work(path, "out", (share * whole.len() as f64) as u64) {
            child.kill().unwrap();
            child.wait().unwrap();
            if partial.exists() {
                kills += 1;
                assert!(!path.join("out").exists());
            }
        }
    }
    assert!(kills > 0, "too fast to be killed");
    let last = glisson(path, &arguments("out", &["--json"]));
    let answer: serde_json::Value = serde_json::from_slice(&last.stdout).unwrap();
    assert!(answer["resumed_nodes"].as_u64().unwrap() >= 16, "{answer}");
    assert!(bytes(&path.join("out")) == whole);
    assert_eq!(files(path), ["block.tet", "out", "whole"]);
}

#[cfg(unix)]
#[test]
fn ctrl_c_tells_how_to_go_on() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    block(path, 8);
    let (child, partial) = caught_at_work(path, "out", 1_000_000).expect("too fast to be interrupted");
    let interrupt = Command::new("sh").args(["-c", &format!("kill -INT {}", child.id())]).status().unwrap();
    assert!(interrupt.success());
    let output = child.wait_with_output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    for text in ["stopping", "error: pre-computing block.tet: stopped after", "out.partial", "again to go on"]
    {
        assert!(message.contains(text), "no {text:?} in {message}");
    }
    assert!(partial.exists() && !path.join("out").exists());
    let last = glisson(path, &arguments("out", &[]));
    let printed = String::from_utf8_lossy(&last.stdout).into_owned();
    assert!(last.status.success() && printed.contains("by an interrupted run"), "{printed}");
}

/// A limit on the size of files stands for a disk that is full.
#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_keeps_what_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    block(path, 6);
    std::fs::write(path.join("out"), "an older file").unwrap();
    let line = arguments("out", &[]).iter().map(|a| format!("'{a}'")).collect::<Vec<_>>().join(" ");
    // In units of 512 bytes; too large a file is then an error rather than a signal.
    let script = format!("trap '' XFSZ; ulimit -f 1500; exec '{}' {line}", env!("CARGO_BIN_EXE_glisson"));
    let output = Command::new("sh").args(["-c", &script]).current_dir(path).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{message}");
    for text in ["error: pre-computing block.tet: out.partial: ", "nodes are kept there", "make room"] {
        assert!(message.contains(text), "no {text:?} in {message}");
    }
    assert_eq!(bytes(&path.join("out")), b"an older file");
    let last = glisson(path, &arguments("out", &["--json"]));
    let answer: serde_json::Value = serde_json::from_slice(&last.stdout).unwrap();
    assert!(answer["resumed_nodes"].as_u64().unwrap() >= 16, "{answer}");
    assert!(glisson(path, &arguments("whole", &[])).status.success());
    assert!(bytes(&path.join("out")) == bytes(&path.join("whole")));
}

#[test]
fn what_is_left_of_another_precomputation_is_refused_until_told_to_start_over() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    block(path, 4);
    assert!(glisson(path, &arguments("out", &["--precision", "f32"])).status.success());
    let short = bytes(&path.join("out"));
    std::fs::write(path.join("out.partial"), &short[..short.len() / 2]).unwrap();
    refuses(path, &arguments("out", &[]), &["out.partial", "as many bytes as 4", "--restart"]);
    std::fs::write(path.join("out.partial"), "mine").unwrap();
    refuses(path, &arguments("out", &[]), &["out.partial", "not a pre-computed compliance", "--restart"]);
    let printed = glisson(path, &arguments("out", &["--restart", "--check"]));
    let text = String::from_utf8_lossy(&printed.stdout).into_owned();
    assert!(printed.status.success() && text.contains("direct solutions at"), "{text}");
    let long = bytes(&path.join("out"));
    assert!(long.len() > 18 * short.len() / 10, "{} {}", long.len(), short.len());
    assert_eq!(files(path), ["block.tet", "out"]);
}

#[test]
fn bodies_that_cannot_be_held_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path();
    let write = |name: &str, text: &str| std::fs::write(path.join(name), text).unwrap();
    write("one.tet", "4 1\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n0 1 2 3\n");
    write(
        "two.tet",
        "8 2\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n0 0 200\n60 0 200\n0 60 200\n0 0 260\n0 1 2 3\n4 5 6 7\n",
    );
    let run = |mesh: &'static str, more: &[&'static str]| {
        [&["precompute", mesh, "-o", "out", "--poisson", "0.45"][..], more].concat()
    };
    let soft = ["--young-kpa", "5"];
    refuses(path, &run("one.tet", &soft), &["one.tet", "6 rigid motions", "rotation", "--fix-box-mm"]);
    let corner = ["--young-kpa", "5", "--fix-ball-mm=0,0,0,1"];
    refuses(path, &run("one.tet", &corner), &["one.tet", "3 of its 6 rigid motions", "rotation about x"]);
    let edge = ["--young-kpa", "5", "--fix-box-mm=0,0,0,60,0,0"];
    refuses(path, &run("one.tet", &edge), &["1 of its 6 rigid motions", "rotation about x"]);
    // Two pieces, one of them held.
    let below = ["--young-kpa", "5", "--fix-box-mm=-1,-1,-1,61,61,1"];
    let expected = ["two.tet", "piece of 4 nodes around node 4 floats", "6 of its 6 rigid motions"];
    refuses(path, &run("two.tet", &below), &expected);
    let everything = ["--young-kpa", "5", "--fix-box-mm=-1,-1,-1,61,61,61"];
    refuses(path, &run("one.tet", &everything), &["all 4 nodes of the surface are fixed"]);
    let half = ["precompute", "one.tet", "-o", "out", "--young-kpa", "5", "--fix-ball-mm=0,0,0,70"];
    for (ratio, expected) in [("0.5", "0.5"), ("nan", "NaN")] {
        refuses(path, &[&half[..], &["--poisson", ratio]].concat(), &["Poisson", expected]);
    }
    refuses(path, &["precompute", "gone.tet", "-o", "out", "--tissue", "liver"], &["gone.tet"]);
    refuses(
        path,
        &["precompute", "one.tet", "-o", "no/out", "--tissue", "liver", below[2]],
        &["no/out.partial"],
    );
    // Both held: two organs in one file.
    let both = [&below[..], &["--fix-box-mm=-1,-1,199,61,61,201"]].concat();
    assert!(glisson(path, &run("two.tet", &both)).status.success());
}
