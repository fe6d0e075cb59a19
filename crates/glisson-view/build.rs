//! Has the program compiled anew when the viewer that is embedded in it is built, also when there was none before.

fn main() {
    // A packaged crate has it in the folder `pages`, which in the repository leads here.
    let (viewer, source) = ("../../web/dist", "../../web/package.json");
    if std::path::Path::new(source).exists() {
        // One that is not there would count as changed each time; where it cannot be made that is all that happens.
        let _ = std::fs::create_dir_all(viewer);
    }
    println!("cargo::rerun-if-changed=pages");
}
