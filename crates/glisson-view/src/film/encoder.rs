//! Pictures to a film, by `ffmpeg`, which gets them through a pipe as they are.

use glisson_picture::Picture;
use std::ffi::OsString;
use std::fs::File;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Child, ChildStderr, Command, ExitStatus, Stdio};
use std::thread::JoinHandle;

/// So much of what the encoder says is told when it fails: lines, and bytes that are kept.
const TOLD_LINES: usize = 5;
const KEPT_BYTES: usize = 4096;
/// What the encoder is called where nothing else is said.
pub const FFMPEG: &str = "ffmpeg";

/// Why there is no film.
#[derive(Debug, thiserror::Error)]
pub enum EncoderError {
    /// It is not installed.
    #[error(
        "{}: there is no such program. A film needs ffmpeg: `apt-get install ffmpeg`, `brew install ffmpeg`, \
         `winget install ffmpeg`, or from https://ffmpeg.org/download.html; where it is not on the PATH, say where with --ffmpeg",
        program.display()
    )]
    Missing {
        /// As it was looked for.
        program: PathBuf,
    },
    /// It cannot be started.
    #[error("{}: cannot be started: {source}", program.display())]
    NotStarted {
        /// The program.
        program: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// It gave up.
    #[error("{} failed ({status}){}", program.display(), told(said))]
    Failed {
        /// The program.
        program: PathBuf,
        /// What it ended with.
        status: ExitStatus,
        /// The last that it said.
        said: String,
    },
    /// The file cannot be written.
    #[error("{}: cannot write: {source}", path.display())]
    NotWritten {
        /// The file.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

fn told(said: &str) -> String {
    let lines: Vec<&str> = said.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    if lines.is_empty() {
        return " and said nothing".to_string();
    }
    format!(":\n  {}", lines[lines.len().saturating_sub(TOLD_LINES)..].join("\n  "))
}

/// As the encoder takes it for a file, whatever signs its name has.
fn file_of(path: &Path) -> OsString {
    let mut file = OsString::from("file:");
    file.push(path);
    file
}

/// A file that goes away unless it is kept.
struct Partial {
    path: PathBuf,
    target: PathBuf,
}

impl Partial {
    /// Beside the file that it will be.
    fn begin(target: &Path) -> Result<Self, EncoderError> {
        let error = |source| EncoderError::NotWritten { path: target.to_path_buf(), source };
        let not_a_file = || error(io::Error::new(io::ErrorKind::InvalidInput, "it is no name of a file"));
        let name = target.file_name().filter(|_| !target.is_dir()).ok_or_else(not_a_file)?;
        let mut partial_name = OsString::from(".");
        partial_name.push(name);
        partial_name.push(format!(".{}.partial", std::process::id()));
        let partial = Self { path: target.with_file_name(partial_name), target: target.to_path_buf() };
        File::create(&partial.path).map_err(error)?;
        Ok(partial)
    }

    fn keep(&self) -> Result<(), EncoderError> {
        let whole = File::open(&self.path).and_then(|file| file.sync_all());
        whole
            .and_then(|()| std::fs::rename(&self.path, &self.target))
            .map_err(|source| EncoderError::NotWritten { path: self.target.clone(), source })
    }
}

impl Drop for Partial {
    fn drop(&mut self) {
        // After `keep` there is none.
        let _ = std::fs::remove_file(&self.path);
    }
}

/// An encoder at work. Nothing is left of a film that is not finished.
pub struct Encoder {
    program: PathBuf,
    child: Child,
    /// What the encoder says.
    said: Option<JoinHandle<Vec<u8>>>,
    partial: Partial,
}

impl Encoder {
    /// Starts `program` for a film of pictures of `size` pixels, both even, `rate_hz` a second.
    ///
    /// # Errors
    /// When there is no such program, or the file cannot be made.
    pub fn start(
        program: &Path,
        target: &Path,
        size: [usize; 2],
        rate_hz: u32,
    ) -> Result<Self, EncoderError> {
        let partial = Partial::begin(target)?;
        let [width, height] = size;
        let (size, rate) = (format!("{width}x{height}"), rate_hz.to_string());
        let raw = [
            "-f",
            "rawvideo",
            "-pixel_format",
            "rgb24",
            "-video_size",
            &size,
            "-framerate",
            &rate,
            "-i",
            "-",
        ];
        // The colours of HDTV (ITU-R BT.709), said in the file too; half as many colours as pixels, which every player takes.
        let colours = [
            "-vf",
            "scale=out_color_matrix=bt709:out_range=tv,format=yuv420p",
            "-colorspace",
            "bt709",
            "-color_primaries",
            "bt709",
            "-color_trc",
            "bt709",
        ];
        // Neither dates nor the encoder's version, and its head in front, so that it plays while it is fetched.
        let film = ["-an", "-c:v", "libx264", "-preset", "medium", "-crf", "19", "-map_metadata", "-1"];
        let file = ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-movflags", "+faststart", "-f", "mp4"];
        let mut child = Command::new(program)
            .args(["-hide_banner", "-loglevel", "error", "-nostdin", "-y"])
            .args(raw)
            .args(film)
            .args(colours)
            .args(file)
            .arg(file_of(&partial.path))
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .map_err(|source| match source.kind() {
                io::ErrorKind::NotFound => EncoderError::Missing { program: program.to_path_buf() },
                _ => EncoderError::NotStarted { program: program.to_path_buf(), source },
            })?;
        let said = child.stderr.take().map(|stderr| std::thread::spawn(move || last_of(stderr)));
        Ok(Self { program: program.to_path_buf(), child, said, partial })
    }

    /// Hands on the next picture.
    ///
    /// # Errors
    /// When the encoder has given up.
    pub fn add(&mut self, picture: &Picture) -> Result<(), EncoderError> {
        let stdin = self.child.stdin.as_mut();
        if stdin.is_some_and(|stdin| stdin.write_all(picture.rgb()).is_ok()) {
            return Ok(());
        }
        // It reads no more, and says why itself.
        let status = self.wait()?;
        Err(self.failed(status))
    }

    /// Waits until all is encoded, and puts the film into its place.
    ///
    /// # Errors
    /// When the encoder fails, or the file cannot be put there.
    pub fn finish(mut self) -> Result<(), EncoderError> {
        let status = self.wait()?;
        if status.success() { self.partial.keep() } else { Err(self.failed(status)) }
    }

    /// Tells it that there are no more pictures.
    fn wait(&mut self) -> Result<ExitStatus, EncoderError> {
        drop(self.child.stdin.take());
        let program = || self.program.clone();
        self.child.wait().map_err(|source| EncoderError::NotStarted { program: program(), source })
    }

    fn failed(&mut self, status: ExitStatus) -> EncoderError {
        let said = self.said.take().and_then(|said| said.join().ok()).unwrap_or_default();
        let said = String::from_utf8_lossy(&said).into_owned();
        EncoderError::Failed { program: self.program.clone(), status, said }
    }
}

impl Drop for Encoder {
    fn drop(&mut self) {
        // Of one that has ended there is nothing to stop.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The last that somebody says, until the end.
fn last_of(mut from: ChildStderr) -> Vec<u8> {
    let (mut kept, mut bytes) = (Vec::new(), [0; KEPT_BYTES]);
    while let Ok(n @ 1..) = from.read(&mut bytes) {
        kept.extend(&bytes[..n]);
        kept.drain(..kept.len().saturating_sub(KEPT_BYTES));
    }
    kept
}
