//! Has the program compiled anew when the viewer that is embedded in it (`web/dist`) is built, also when there was none before.

fn main() {
    let viewer = "../../web/dist";
    // One that is not there would count as changed each time; where it cannot be made that is all that happens.
    let _ = std::fs::create_dir_all(viewer);
    println!("cargo::rerun-if-changed={viewer}");
}
