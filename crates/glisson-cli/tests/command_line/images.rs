//! Images and shapes as a careless user hands them over.

use std::path::Path;

use super::{glisson, refuses};

/// A block of labels of `n` voxels of 5 mm, with a ball of label 1 and its other half of label 2, as text.
fn ball(folder: &Path, name: &str, center: [i32; 3]) {
    const N: i32 = 16;
    let mut text = format!(
        "NRRD0004\ntype: uchar\ndimension: 3\nspace: LPS\nsizes: {N} {N} {N}\nspace directions: (5,0,0) (0,5,0) (0,0,5)\n\
         encoding: text\nspace origin: (-40,-40,-40)\nSegment0_ID:=a\nSegment0_Name:=kidney\nSegment0_LabelValue:=1\n\
         Segment1_ID:=b\nSegment1_Name:=cyst\nSegment1_LabelValue:=2\n\n"
    );
    for voxel in 0..N * N * N {
        let place = [voxel % N, voxel / N % N, voxel / N / N];
        let squared: i32 = (0..3).map(|a| (place[a] - center[a]).pow(2)).sum();
        let label = if squared > 30 { 0 } else { 1 + i32::from(place[0] > center[0]) };
        text += &format!("{label} ");
    }
    std::fs::write(folder.join(name), text).unwrap();
}

fn says(folder: &Path, arguments: &[&str]) -> (String, String) {
    let output = glisson(folder, arguments);
    let (said, warned) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "glisson {}: {warned}", arguments.join(" "));
    (said.into_owned(), warned.into_owned())
}

#[test]
fn an_import_says_what_is_there_and_writes_it() {
    let folder = tempfile::tempdir().unwrap();
    ball(folder.path(), "a.nrrd", [8, 8, 8]);
    let (said, _) = says(folder.path(), &["import", "a.nrrd", "-o", "b.nii.gz"]);
    for words in [
        "NRRD",
        "16 x 16 x 16 of 5.000",
        "i to left, j to posterior, k to superior",
        "1    kidney",
        "2    cyst",
    ] {
        assert!(said.contains(words), "no `{words}` in {said}");
    }
    let (said, _) = says(folder.path(), &["import", "b.nii.gz", "--json"]);
    let answer: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(answer["contents"]["labels"][1]["name"], "cyst");
    // One name, or several with a plus between them.
    let (said, _) = says(
        folder.path(),
        &["mesh", "b.nii.gz", "--label", "kidney+cyst", "--tetrahedra", "1000", "-o", "b.vtu"],
    );
    assert!(said.contains("label        kidney + cyst"), "{said}");
}

#[test]
fn what_cannot_be_imported_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    ball(folder.path(), "a.nrrd", [8, 8, 8]);
    std::fs::write(folder.path().join("notes.txt"), "nothing").unwrap();
    std::fs::create_dir(folder.path().join("empty")).unwrap();
    for (arguments, expected) in [
        (&["import", "none.nrrd"][..], &["none.nrrd", "cannot be read"][..]),
        (&["import", "notes.txt"], &["notes.txt", "begins with \"nothing\"", ".nii.gz"]),
        (&["import", "empty"], &["empty", "no DICOM image found among 0 file(s)"]),
        (&["import", "a.nrrd", "-o", "b.png"], &["b.png", "must end in one of .nii, .nii.gz"]),
        (
            &["mesh", "a.nrrd", "--label", "liver", "-o", "b.vtu"],
            &["no label named `liver`", "1 (kidney), 2 (cyst)"],
        ),
        (&["mesh", "a.nrrd", "--unit", "cm", "-o", "b.vtu"], &["a.nrrd", "--unit is for surfaces"]),
    ] {
        refuses(folder.path(), arguments, expected);
    }
}

#[test]
fn an_organ_that_the_border_cuts_off_is_closed_when_asked() {
    let folder = tempfile::tempdir().unwrap();
    ball(folder.path(), "a.nrrd", [8, 8, 2]);
    let mesh = ["mesh", "a.nrrd", "--label", "kidney+cyst", "--tetrahedra", "1000", "-o", "b.vtu"];
    refuses(folder.path(), &mesh, &["--cut-at-border"]);
    let (said, _) = says(folder.path(), &[&mesh[..], &["--cut-at-border"]].concat());
    assert!(said.contains("closed with a flat face at k = 0 (inferior)"), "{said}");
}

/// The lines of the surface of a ball, in millimetres.
fn ball_surface(folder: &Path) -> String {
    ball(folder, "a.nrrd", [8, 8, 8]);
    let mesh = ["mesh", "a.nrrd", "--label", "kidney+cyst", "--tetrahedra", "1000", "-o", "b.vtu"];
    says(folder, &[&mesh[..], &["--surface-out", "b.obj"]].concat());
    std::fs::read_to_string(folder.join("b.obj")).unwrap()
}

#[test]
fn a_surface_in_another_unit_is_warned_of() {
    let folder = tempfile::tempdir().unwrap();
    let text = ball_surface(folder.path());
    // The same numbers, but in metres.
    let in_metres = text.lines().map(|line| match line.strip_prefix("v ") {
        Some(numbers) => {
            let scaled =
                numbers.split_whitespace().map(|n| format!("{}", n.parse::<f64>().unwrap() / 1000.0));
            format!("v {}\n", scaled.collect::<Vec<_>>().join(" "))
        }
        None => format!("{line}\n"),
    });
    std::fs::write(folder.path().join("m.obj"), in_metres.collect::<String>()).unwrap();
    let (_, warned) = says(folder.path(), &["check", "m.obj"]);
    assert!(warned.contains("organs have 1 ml to 20 l") && warned.contains("--unit m"), "{warned}");
    let (_, warned) = says(folder.path(), &["check", "m.obj", "--unit", "m"]);
    assert!(warned.is_empty(), "{warned}");
    says(folder.path(), &["mesh", "m.obj", "--unit", "m", "--tetrahedra", "1000", "-o", "m.vtu"]);
}

#[test]
fn a_surface_with_a_hole_is_meshed_when_repair_is_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let text = ball_surface(folder.path());
    // Four triangles less, and one doubled.
    let (faces, others): (Vec<&str>, Vec<&str>) = text.lines().partition(|line| line.starts_with("f "));
    let broken = [&others[..], &faces[4..], &faces[20..21]].concat().join("\n");
    std::fs::write(folder.path().join("broken.obj"), broken + "\n").unwrap();
    let mesh = ["mesh", "broken.obj", "--tetrahedra", "1000", "-o", "c.vtu"];
    refuses(folder.path(), &mesh, &["broken.obj", "`--repair` closes such surfaces"]);
    let (said, _) = says(folder.path(), &[&mesh[..], &["--repair"]].concat());
    for words in ["open edges at", "1 doubled triangles", "drawn anew on a grid", "volume"] {
        assert!(said.contains(words), "no `{words}` in {said}");
    }
    let (said, _) = says(folder.path(), &["repair", "broken.obj", "-o", "closed.stl", "--json"]);
    let report: serde_json::Value = serde_json::from_str(&said).unwrap();
    assert_eq!(report["rebuilt"], true);
    says(folder.path(), &["check", "closed.stl"]);
}

/// A DICOM file of one slice of 2 x 2 voxels, element by element, of a patient with a name.
fn dicom_slice(path: &Path) {
    let element = |group: u16, number: u16, kind: &str, value: &[u8]| {
        let mut bytes = [group.to_le_bytes(), number.to_le_bytes()].concat();
        bytes.extend(kind.as_bytes());
        let fill = if kind == "UI" { 0 } else { b' ' };
        let mut value = value.to_vec();
        if value.len() % 2 == 1 {
            value.push(fill);
        }
        match kind {
            "OB" | "OW" => {
                bytes.extend([0, 0]);
                bytes.extend((value.len() as u32).to_le_bytes());
            }
            _ => bytes.extend((value.len() as u16).to_le_bytes()),
        }
        [bytes, value].concat()
    };
    let short = |group, number, value: u16| element(group, number, "US", &value.to_le_bytes());
    let class = b"1.2.840.10008.5.1.4.1.1.2";
    let header = [
        element(2, 1, "OB", &[0, 1]),
        element(2, 2, "UI", class),
        element(2, 3, "UI", b"1.2.3.4"),
        element(2, 0x10, "UI", b"1.2.840.10008.1.2.1"),
        element(2, 0x12, "UI", b"1.2.3"),
    ]
    .concat();
    let image = [
        element(8, 0x16, "UI", class),
        element(8, 0x18, "UI", b"1.2.3.4"),
        element(8, 0x60, "CS", b"CT"),
        element(0x10, 0x10, "PN", b"Zzyzx^Quintilla"),
        element(0x18, 0x50, "DS", b"2.5"),
        element(0x20, 0x32, "DS", b"1\\2\\3"),
        element(0x20, 0x37, "DS", b"1\\0\\0\\0\\1\\0"),
        short(0x28, 2, 1),
        element(0x28, 4, "CS", b"MONOCHROME2"),
        short(0x28, 0x10, 2),
        short(0x28, 0x11, 2),
        element(0x28, 0x30, "DS", b"0.5\\0.5"),
        short(0x28, 0x100, 16),
        short(0x28, 0x101, 16),
        short(0x28, 0x102, 15),
        short(0x28, 0x103, 0),
        element(0x7fe0, 0x10, "OW", &[1, 0, 2, 0, 3, 0, 4, 0]),
    ]
    .concat();
    let length = element(2, 0, "UL", &(header.len() as u32).to_le_bytes());
    std::fs::write(path, [&[0; 128], &b"DICM"[..], &length, &header, &image].concat()).unwrap();
}

#[test]
fn copies_do_not_tell_the_patient_nor_of_each_other() {
    let folder = tempfile::tempdir().unwrap();
    dicom_slice(&folder.path().join("Zzyzx.dcm"));
    let copy = |out| says(folder.path(), &["import", "Zzyzx.dcm", "--anonymize", out]).0;
    assert!(copy("a").contains("copied     1 file(s) of 1 series"));
    copy("b");
    let [a, b] = ["a", "b"].map(|out| std::fs::read(folder.path().join(out).join("slice_0001.dcm")).unwrap());
    assert!(!a.windows(5).any(|window| window == b"Zzyzx"));
    // Each call has a key of its own.
    assert_ne!(a, b);
    let (said, _) = says(folder.path(), &["import", "a"]);
    assert!(
        said.contains("2 x 2 x 1 of 0.500 x 0.500 x 2.500") && said.contains("values     1 to 4"),
        "{said}"
    );
    refuses(
        folder.path(),
        &["import", "Zzyzx.dcm", "--anonymize", "a"],
        &["a: cannot write", "files in it is there already", "a folder that is not there or is empty"],
    );
    ball(folder.path(), "a.nrrd", [8, 8, 8]);
    let no_dicom = ["import", "a.nrrd", "--anonymize", "c"];
    refuses(folder.path(), &no_dicom, &["a.nrrd", "copies without the patient are made of DICOM"]);
}

#[test]
fn pictures_of_slices_are_imported_with_distances() {
    let folder = tempfile::tempdir().unwrap();
    let stack = folder.path().join("stack");
    std::fs::create_dir(&stack).unwrap();
    for k in 0..3u8 {
        let file = std::fs::File::create(stack.join(format!("slice{}.png", 9 + k))).unwrap();
        let mut encoder = png::Encoder::new(file, 2, 2);
        encoder.set_color(png::ColorType::Rgb);
        let bytes: Vec<u8> = (0..12).map(|n| 60 * k + 5 * n).collect();
        encoder.write_header().unwrap().write_image_data(&bytes).unwrap();
    }
    refuses(folder.path(), &["import", "stack"], &["3 picture(s) of slices", "--spacing-mm X,Y,Z"]);
    let import = ["import", "stack", "--spacing-mm", "0.33,0.33,1"];
    let green = [&import[..], &["--channel", "green", "--head-first", "--labels", "false", "-o", "g.nii.gz"]]
        .concat();
    let (said, _) = says(folder.path(), &green);
    for words in
        ["pictures of slices", "2 x 2 x 3 of 0.330 x 0.330 x 1.000", "k to inferior", "of the colours green"]
    {
        assert!(said.contains(words), "no `{words}` in {said}");
    }
    assert!(said.contains("values     5 to 170"), "{said}");
    let (said, _) = says(folder.path(), &["import", "g.nii.gz", "--labels", "false"]);
    assert!(said.contains("values     5 to 170") && said.contains("k to inferior"), "{said}");
    refuses(folder.path(), &[&import[..], &["--size", "2,2"]].concat(), &["leave --size out"]);
    for (arguments, words) in [
        (["--spacing-mm", "0.33,1"], "`0.33,1` is not 3 numbers"),
        (["--channel", "red"], "--spacing-mm <X,Y,Z>"),
    ] {
        let output = glisson(folder.path(), &[&["import", "stack"], &arguments[..]].concat());
        let message = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && message.contains(words), "{message}");
    }
}
