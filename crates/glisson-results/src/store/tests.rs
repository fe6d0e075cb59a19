//! What a store keeps, and what it does with files that are none, locked, full or of another version.

use super::*;
use crate::attempt::{KeptError, scene_hash};
use crate::export;
use crate::statistics::Standing;
use crate::utc::utc_text;
use glisson::training::metrics::{Better, Validity};
use glisson::training::task::{MetricLine, TaskResult};
use serde_json::json;

fn metric(
    name: &'static str,
    tool: Option<&str>,
    value: f64,
    unit: &'static str,
    better: Better,
) -> MetricLine {
    let tool = tool.map(str::to_owned);
    let (formula, source, validity) = ("", "", Validity::None);
    MetricLine { name, title: name, tool, value, unit, better, formula, source, validity }
}

/// A passed attempt of so many seconds.
fn kept(person: &str, minute: i64, time_s: f64) -> Kept {
    let result = TaskResult {
        title: "Press, \"here\"".into(),
        level: None,
        outcome: Some(Outcome::Done),
        began_s: Some(0.1),
        is_passed: true,
        n_stages: 1,
        stages: Vec::new(),
        gate: Vec::new(),
        metrics: vec![
            metric("time", None, time_s, "s", Better::Less),
            metric("path_length", Some("probe"), 0.01 * time_s, "m", Better::Less),
            metric("path_length", Some("hook"), 0.1 + 0.2, "m", Better::Less),
            metric("smoothness_sparc", Some("probe"), -time_s, "", Better::More),
            metric("grasps", Some("probe"), time_s, "", Better::Neither),
        ],
        events: Vec::new(),
        moments: Vec::new(),
        gestures: Vec::new(),
    };
    let attempt = Attempt {
        person: Some(person.into()),
        task: "press".into(),
        scene_hash: scene_hash("a scene"),
        finished_at: utc_text(1_700_000_000_000 + 60_000 * minute),
        seed: Some(7),
        level: None,
        session: Some("out/press.jsonl".into()),
    };
    Kept { attempt, result: serde_json::to_value(result).unwrap() }
}

fn with(kept: Kept, field: &str, value: serde_json::Value) -> Kept {
    let mut other = kept;
    other.result[field] = value;
    other
}

fn store() -> (Store, tempfile::TempDir) {
    let folder = tempfile::tempdir().unwrap();
    (Store::open(&folder.path().join("r.sqlite")).unwrap(), folder)
}

fn count(store: &Store, table: &str) -> i64 {
    store.connection.query_row(&format!("SELECT count(*) FROM {table}"), [], |row| row.get(0)).unwrap()
}

#[test]
fn a_result_comes_back_as_it_was_stored_and_is_stored_once() {
    let (mut store, folder) = store();
    let first = kept(" Ada ", 5, 12.345_678_901_234_5);
    assert_eq!(store.add(&first).unwrap(), Added::New(1));
    assert_eq!(store.add(&kept("Ada", 1, 20.0)).unwrap(), Added::New(2));
    assert_eq!(store.add(&first).unwrap(), Added::There(1));
    // Two attempts may end in the same millisecond; each has its session.
    let mut other = first.clone();
    other.attempt.session = Some("other.jsonl".into());
    assert_eq!(store.add(&other).unwrap(), Added::New(3));
    assert_eq!(store.add(&other).unwrap(), Added::There(3));
    assert!(store.delete(3).is_ok());
    drop(store);
    let store = Store::open_existing(&folder.path().join("r.sqlite")).unwrap();
    let found = store.results(&Filter::default()).unwrap();
    assert_eq!(found.iter().map(|result| result.id).collect::<Vec<_>>(), [2, 1], "in the order of time");
    let StoredResult { kept: back, result, duration_s, person, .. } = &found[1];
    assert_eq!(back.result, first.result);
    assert_eq!(back.attempt, Attempt { person: Some("Ada".into()), ..first.attempt });
    assert_eq!((*duration_s, person.as_str(), result.is_passed), (Some(12.345_678_901_234_5), "Ada", true));
    assert_eq!(result.metric("path_length", Some("hook")).unwrap().value, Some(0.1 + 0.2));
    assert_eq!(count(&store, "metric"), 10);
}

#[test]
fn results_are_found_by_person_and_task_and_mistakes_are_named() {
    let (mut store, _folder) = store();
    for (person, minute) in [("Ada", 1), ("Ben", 2), ("Ada", 3)] {
        store.add(&kept(person, minute, 9.0)).unwrap();
    }
    let find = |person: Option<&str>, task: Option<&str>| {
        store.results(&Filter {
            person: person.map(str::to_owned),
            task: task.map(str::to_owned),
            ..Filter::default()
        })
    };
    assert_eq!(find(Some("Ada"), None).unwrap().len(), 2);
    assert_eq!(find(Some("Ben"), Some("press")).unwrap().len(), 1);
    let error = find(Some("Adda"), None).unwrap_err().to_string();
    assert!(error.contains("there is no person \"Adda\"; did you mean \"Ada\"?"), "{error}");
    let error = find(None, Some("cut")).unwrap_err().to_string();
    assert!(error.contains("there is no task \"cut\"; there are: press"), "{error}");
    assert!(store.result(9).unwrap_err().to_string().contains("there is no result 9"));
}

#[test]
fn what_is_not_finite_is_no_metric_and_stays_in_the_text() {
    let (mut store, _folder) = store();
    let broken = serde_json::to_value(f64::NAN).unwrap();
    let mut odd = kept("Ada", 1, 9.0);
    odd.result["metrics"][0]["value"] = broken;
    store.add(&odd).unwrap();
    assert_eq!(count(&store, "metric"), 4);
    assert_eq!(store.result(1).unwrap().duration_s, None);
}

#[test]
fn a_wrong_field_is_named_and_nothing_is_stored() {
    let (mut store, _folder) = store();
    let good = kept("Ada", 1, 9.0);
    let attempt = |change: fn(&mut Attempt)| {
        let mut other = good.clone();
        change(&mut other.attempt);
        other
    };
    for (wrong, expected) in [
        (attempt(|attempt| attempt.person = None), "no person; give one with --person"),
        (attempt(|attempt| attempt.person = Some("\u{7}".into())), "U+0007"),
        (
            attempt(|attempt| attempt.finished_at = "yesterday".into()),
            "`attempt.finished_at` is \"yesterday\"",
        ),
        (attempt(|attempt| attempt.scene_hash = "0".repeat(63)), "64 digits"),
        (attempt(|attempt| attempt.task = String::new()), "`attempt.task`"),
        (with(good.clone(), "outcome", json!("won")), "unknown variant `won`"),
        (with(good.clone(), "metrics", json!(3)), "is not that of a task"),
    ] {
        let error = store.add(&wrong).unwrap_err();
        assert!(matches!(error, StoreError::Kept(_)) && error.to_string().contains(expected), "{error}");
    }
    let twice = json!([good.result["metrics"][0], good.result["metrics"][0]]);
    assert!(store.add(&with(good, "metrics", twice)).is_err());
    assert_eq!((count(&store, "person"), count(&store, "result")), (0, 0));
    assert!(matches!(kept("Ada", 1, 1.0).checked(), Ok((name, _)) if name == "Ada"));
    assert!(KeptError::NoPerson.to_string().contains("--person"));
}

#[test]
fn who_is_forgotten_leaves_nothing_in_the_file() {
    let (mut store, folder) = store();
    for (person, minute) in [("Zebedee", 1), ("Zebedee", 2), ("Ben", 3)] {
        store.add(&kept(person, minute, 9.0)).unwrap();
    }
    store.add_to_group("experts", &["Zebedee".into(), "Ben".into()]).unwrap();
    store.delete(1).unwrap();
    assert!(store.delete(1).is_err());
    assert_eq!((count(&store, "result"), count(&store, "metric")), (2, 10));
    store.forget("Zebedee").unwrap();
    assert!(store.forget("Zebedee").is_err());
    assert_eq!((count(&store, "person"), count(&store, "result"), count(&store, "metric")), (1, 1, 5));
    assert_eq!(store.members("experts").unwrap(), ["Ben"]);
    // A number that was given is not given again.
    assert_eq!(store.add(&kept("Ben", 4, 1.0)).unwrap(), Added::New(4));
    drop(store);
    let bytes = std::fs::read(folder.path().join("r.sqlite")).unwrap();
    assert!(!bytes.windows(7).any(|window| window == b"Zebedee"), "the name is still in the file");
    assert!(bytes.windows(3).any(|window| window == b"Ben"));
}

#[test]
fn groups_are_made_changed_and_removed() {
    let (mut store, _folder) = store();
    for person in ["Ada", "Ben", "Cleo"] {
        store.add(&kept(person, 1, 9.0)).unwrap();
    }
    assert!(store.groups().unwrap().is_empty(), "no group but those that users make");
    let names = |names: &[&str]| names.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>();
    store.add_to_group("experts", &names(&["Ben", "Ada"])).unwrap();
    store.add_to_group("experts", &names(&["Ada"])).unwrap();
    assert!(
        store.add_to_group("experts", &names(&["Cleo", "Dan"])).unwrap_err().to_string().contains("\"Dan\"")
    );
    assert_eq!(store.members("experts").unwrap(), ["Ada", "Ben"]);
    assert_eq!(
        store.people().unwrap()[0],
        Person { name: "Ada".into(), n_results: 1, groups: names(&["experts"]) }
    );
    store.remove_from_group("experts", &names(&["Ada"])).unwrap();
    assert!(store.remove_from_group("experts", &names(&["Ada"])).is_err());
    assert_eq!(store.members("experts").unwrap(), ["Ben"]);
    store.remove_from_group("experts", &[]).unwrap();
    assert!(store.members("experts").unwrap_err().to_string().contains("there is no group"));
}

#[test]
fn a_result_is_compared_with_the_last_passed_ones_of_a_group_without_its_own() {
    let (mut store, _folder) = store();
    let mut people = Vec::new();
    // Each of the group was slow at first, and fast and not safe in the end: 10, 20, 30, 40 s count.
    for (place, person) in (0..).zip(["A", "B", "C", "D"]) {
        store.add(&kept(person, place, 99.0)).unwrap();
        store.add(&kept(person, 10 + place, 10.0 * (place + 1) as f64)).unwrap();
        let unsafe_one = with(kept(person, 20 + place, 1.0), "is_passed", json!(false));
        store.add(&unsafe_one).unwrap();
        people.push(person.to_owned());
    }
    let other_scene = {
        let mut other = kept("A", 30, 1.0);
        other.attempt.scene_hash = scene_hash("a changed scene");
        other
    };
    store.add(&other_scene).unwrap();
    let id = store.add(&kept("Me", 40, 15.0)).unwrap().id();
    people.push("Me".into());
    store.add_to_group("experts", &people).unwrap();

    let comparison = store.compare(id, Some("experts")).unwrap();
    assert_eq!(comparison.reference.as_ref().unwrap().n_people, 4);
    let time = comparison.metric("time", None).unwrap();
    let found = time.quartiles.unwrap();
    assert_eq!([found.first, found.median, found.third], [17.5, 25.0, 32.5]);
    assert_eq!(time.standing, Some(Standing::Better));
    // -15 is above all of -40 .. -10 but one, and more is better.
    let smooth = comparison.metric("smoothness_sparc", Some("probe")).unwrap();
    assert_eq!(smooth.standing, Some(Standing::Better));
    assert_eq!(comparison.metric("path_length", Some("hook")).unwrap().standing, Some(Standing::As));
    assert_eq!(comparison.metric("grasps", Some("probe")).unwrap().standing, None, "it only describes");

    // One of the group is compared with the three others: too few for quartiles, and that is told.
    store.remove_from_group("experts", &["Me".into()]).unwrap();
    let own = store.results(&Filter { person: Some("A".into()), ..Filter::default() }).unwrap()[1].id;
    let comparison = store.compare(own, Some("experts")).unwrap();
    assert_eq!(comparison.reference.as_ref().unwrap().n_people, 3);
    let time = comparison.metric("time", None).unwrap();
    assert_eq!((time.quartiles, time.standing, time.n_people), (None, None, 3));
}

#[test]
fn an_attempt_that_was_not_done_is_not_called_fast() {
    let (mut store, _folder) = store();
    for (place, person) in (0..).zip(["A", "B", "C", "D"]) {
        store.add(&kept(person, place, 10.0)).unwrap();
        store.add_to_group("experts", &[person.to_owned()]).unwrap();
    }
    for (minute, outcome) in
        [(1, json!("done")), (2, json!(null)), (3, json!("time_over")), (4, json!("done"))]
    {
        let mut tried = with(kept("Me", minute, 10.0 - minute as f64), "outcome", outcome);
        tried.result["is_passed"] = json!(false);
        store.add(&tried).unwrap();
    }
    let ids: Vec<i64> = store
        .results(&Filter { person: Some("Me".into()), ..Filter::default() })
        .unwrap()
        .iter()
        .map(|r| r.id)
        .collect();
    let standing = |id| store.compare(id, Some("experts")).unwrap().metric("time", None).unwrap().standing;
    assert_eq!(
        ids.iter().map(|id| standing(*id)).collect::<Vec<_>>(),
        [Some(Standing::Better), None, None, Some(Standing::Better)]
    );
    let (curves, n_left_out) = store.curves(&mine(), "time", Some("experts")).unwrap();
    assert_eq!((curves.len(), n_left_out), (1, 0));
    assert_eq!(curves[0].curve.points, [(1, 9.0), (4, 6.0)]);
    assert_eq!((curves[0].curve.n_attempts, curves[0].curve.band.unwrap().median), (4, 10.0));
    let error = store.curves(&mine(), "tim", None).unwrap_err().to_string();
    assert!(error.contains("there is no metric \"tim\"; did you mean \"time\"?"), "{error}");
}

/// The attempts of "Me" at the task.
fn mine() -> Filter {
    Filter { person: Some("Me".into()), task: Some("press".into()), ..Filter::default() }
}

#[test]
fn results_and_curves_are_those_of_a_level_and_a_patient() {
    let (mut store, _folder) = store();
    for (minute, level, patient) in [(1, "hard", 4), (2, "hard", 4), (3, "normal", 26), (4, "normal", 4)] {
        let mut tried = kept("Me", minute, 10.0);
        tried.attempt.level = Some(level.into());
        tried.attempt.seed = Some(patient);
        tried.attempt.scene_hash = scene_hash(&format!("{level} {patient}"));
        store.add(&tried).unwrap();
    }
    let of = |level: Option<&str>, patient| Filter { level: level.map(str::to_owned), patient, ..mine() };
    let n_found = |filter: Filter| store.results(&filter).unwrap().len();
    assert_eq!(
        (n_found(of(Some("hard"), None)), n_found(of(None, Some(4))), n_found(of(Some("normal"), Some(4)))),
        (2, 3, 1)
    );
    let error = store.results(&of(Some("hart"), None)).unwrap_err().to_string();
    assert!(error.contains("there is no level \"hart\"; did you mean \"hard\"?"), "{error}");
    let (curves, n_left_out) = store.curves(&of(Some("hard"), None), "time", None).unwrap();
    assert_eq!((curves[0].curve.points.len(), n_left_out), (2, 0));
    let error = store.curves(&of(None, Some(7)), "time", None).unwrap_err().to_string();
    assert!(error.contains("there is no such result at the task \"press\""), "{error}");
}

#[test]
fn a_curve_has_the_attempts_at_the_last_scene_of_a_task_and_one_line_an_instrument() {
    let (mut store, _folder) = store();
    let mut before = kept("Me", 1, 9.0);
    before.attempt.scene_hash = scene_hash("as it was");
    store.add(&before).unwrap();
    store.add(&kept("Me", 2, 8.0)).unwrap();
    store.add(&kept("Me", 3, 7.0)).unwrap();
    let (curves, n_left_out) = store.curves(&mine(), "path_length", None).unwrap();
    assert_eq!((n_left_out, curves.len()), (1, 2));
    assert_eq!(curves[0].of.tool.as_deref(), Some("probe"));
    assert_eq!(curves[0].curve.points, [(1, 0.08), (2, 0.07)]);
}

#[test]
fn csv_is_quoted_by_rfc_4180_and_json_is_imported_again() {
    let (mut first, _folder) = store();
    first.add(&kept("Ada, the 1st", 1, 9.5)).unwrap();
    first.add(&with(kept("Ben", 2, 9.0), "metrics", json!([]))).unwrap();
    let results = first.results(&Filter::default()).unwrap();
    let csv = export::csv(&results);
    let lines: Vec<&str> = csv.split_terminator("\r\n").collect();
    assert_eq!(lines.len(), 1 + 5 + 1);
    assert!(lines.iter().all(|line| !line.contains('\n')));
    let hash = scene_hash("a scene");
    let of_ada = format!(
        "1,\"Ada, the 1st\",press,\"Press, \"\"here\"\"\",{hash},2023-11-14T22:14:20.000Z,7,,1,done,9.5,out/press.jsonl"
    );
    assert_eq!(lines[1], format!("{of_ada},time,,9.5,s"));
    assert_eq!(lines[3], format!("{of_ada},path_length,hook,0.30000000000000004,m"));
    assert!(lines[6].starts_with("2,Ben,") && lines[6].ends_with(",out/press.jsonl,,,,"), "{}", lines[6]);

    let text = export::json(&results, &[]).to_string();
    let (mut second, _folder) = store();
    let read = export::read(&text).unwrap();
    for kept in &read {
        assert!(matches!(second.add(kept).unwrap(), Added::New(_)));
    }
    assert_eq!(export::csv(&second.results(&Filter::default()).unwrap()), csv);
    // One of them by itself, as a task writes it.
    assert_eq!(export::read(&serde_json::to_string(&read[0]).unwrap()).unwrap(), read[..1]);
}

#[test]
fn files_without_results_are_refused() {
    for (text, expected) in [
        ("", "it is no result"),
        ("[]", "it is no result"),
        ("{\"result\": {}}", "no `attempt`"),
        ("{\"attempt\": {}, \"result\": {}}", "missing field `task`"),
        ("{\"glisson_results\": 2, \"results\": []}", "version 2"),
        ("{\"glisson_results\": 1}", "it is no result"),
    ] {
        let error = export::read(text).unwrap_err().to_string();
        assert!(error.contains(expected), "{text}: {error}");
    }
}

#[test]
fn two_programs_write_to_one_database_at_once_and_nothing_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("r.sqlite");
    // Both find no file, too.
    std::thread::scope(|scope| {
        for person in ["Ada", "Ben"] {
            let file = &file;
            scope.spawn(move || {
                let mut store = Store::open(file).unwrap();
                for minute in 0..100 {
                    assert!(matches!(store.add(&kept(person, minute, 9.0)).unwrap(), Added::New(_)));
                }
            });
        }
    });
    let store = Store::open_existing(&file).unwrap();
    for person in ["Ada", "Ben"] {
        let of = Filter { person: Some(person.into()), ..Filter::default() };
        let found = store.results(&of).unwrap();
        assert_eq!(found.len(), 100, "{person}");
        assert!(
            found.windows(2).all(|pair| pair[0].kept.attempt.finished_at < pair[1].kept.attempt.finished_at)
        );
    }
    assert_eq!(count(&store, "metric"), 1000);
}

#[test]
fn a_locked_database_says_so_and_takes_the_result_afterwards() {
    let (mut store, folder) = store();
    store.set_patience(Duration::from_millis(50)).unwrap();
    let other = Connection::open(folder.path().join("r.sqlite")).unwrap();
    other.execute_batch("BEGIN EXCLUSIVE").unwrap();
    assert!(matches!(store.check_writable(), Err(StoreError::Locked { .. })));
    let error = store.add(&kept("Ada", 1, 9.0)).unwrap_err();
    assert!(matches!(error, StoreError::Locked { .. }), "{error}");
    let text = error.to_string();
    assert!(text.contains("r.sqlite") && text.contains("locked") && text.contains("try again"), "{text}");
    other.execute_batch("COMMIT").unwrap();
    assert_eq!(store.add(&kept("Ada", 1, 9.0)).unwrap(), Added::New(1));
}

#[test]
fn a_full_disk_says_so_and_keeps_what_was_there() {
    let (mut store, _folder) = store();
    store.add(&kept("Ada", 0, 9.0)).unwrap();
    let pages: i64 = store.connection.query_row("PRAGMA page_count", [], |row| row.get(0)).unwrap();
    let most = format!("PRAGMA max_page_count = {pages}");
    store.connection.query_row(&most, [], |row| row.get::<_, i64>(0)).unwrap();
    let mut n_stored = 1;
    let error = loop {
        match store.add(&kept("Ada", n_stored, 9.0)) {
            Ok(_) => n_stored += 1,
            Err(error) => break error,
        }
        assert!(n_stored < 1000, "{pages} pages hold everything");
    };
    assert!(matches!(error, StoreError::Full { .. }), "{error}");
    assert!(error.to_string().contains("r.sqlite: the disk is full"), "{error}");
    assert_eq!(count(&store, "result"), n_stored);
    assert_eq!(count(&store, "metric"), 5 * n_stored);
    // With room again it goes on.
    store.connection.query_row("PRAGMA max_page_count = 100000", [], |row| row.get::<_, i64>(0)).unwrap();
    store.add(&kept("Ada", n_stored, 9.0)).unwrap();
}

#[test]
fn files_that_are_no_database_of_results_are_refused_and_left_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("r.sqlite");
    let open = || Store::open(&file).map(|_| ()).unwrap_err();
    std::fs::write(&file, "glisson_scene = 1\n".repeat(100)).unwrap();
    let text = open().to_string();
    assert!(text.contains("r.sqlite: found a file of another kind") && text.contains("--database"), "{text}");
    assert_eq!(std::fs::read_to_string(&file).unwrap(), "glisson_scene = 1\n".repeat(100));

    std::fs::remove_file(&file).unwrap();
    Connection::open(&file).unwrap().execute_batch("CREATE TABLE recipe (name TEXT)").unwrap();
    let before = std::fs::read(&file).unwrap();
    assert!(open().to_string().contains("a database of another program"));
    assert_eq!(std::fs::read(&file).unwrap(), before);

    std::fs::remove_file(&file).unwrap();
    drop(Store::open(&file).unwrap());
    Connection::open(&file).unwrap().pragma_update(None, "user_version", 2).unwrap();
    let error = open();
    assert!(matches!(error, StoreError::Newer { found: 2, .. }), "{error}");
    assert!(error.to_string().contains("version 2; this program knows versions up to 1"), "{error}");

    let gone = folder.path().join("gone/r.sqlite");
    assert!(matches!(Store::open(&gone), Err(StoreError::NotOpened { .. })));
    assert!(matches!(Store::open_existing(&gone), Err(StoreError::NotThere { .. })));
    assert!(matches!(Store::open(folder.path()), Err(StoreError::NotOpened { .. })));
}

#[test]
fn a_damaged_database_says_so() {
    let (mut store, folder) = store();
    for minute in 0..20 {
        store.add(&kept("Ada", minute, 9.0)).unwrap();
    }
    drop(store);
    let file = folder.path().join("r.sqlite");
    let mut bytes = std::fs::read(&file).unwrap();
    bytes[4096..].fill(0xa5);
    std::fs::write(&file, bytes).unwrap();
    let found = Store::open_existing(&file).and_then(|store| store.results(&Filter::default()));
    let error = found.unwrap_err();
    assert!(matches!(error, StoreError::Damaged { .. }), "{error}");
}

/// Root writes everywhere, so the file is opened for reading only.
#[test]
fn a_database_that_may_only_be_read_says_so_and_is_read() {
    let (mut store, folder) = store();
    store.check_writable().unwrap();
    store.add(&kept("Ada", 1, 9.0)).unwrap();
    let file = folder.path().join("r.sqlite");
    let connection = Connection::open_with_flags(&file, OpenFlags::SQLITE_OPEN_READ_ONLY).unwrap();
    let mut store = Store { connection, file };
    for error in [store.check_writable().unwrap_err(), store.add(&kept("Ada", 2, 9.0)).unwrap_err()] {
        assert!(matches!(error, StoreError::ReadOnly { .. }), "{error}");
        let text = error.to_string();
        assert!(text.contains("r.sqlite") && text.contains("may only be read"), "{text}");
    }
    assert_eq!(store.results(&Filter::default()).unwrap().len(), 1);
}
