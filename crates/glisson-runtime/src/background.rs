//! Work beside the steps, whose result is taken when its time has come.

/// Work that was begun.
pub(crate) struct Background<T>(Begun<T>);

#[cfg(not(target_family = "wasm"))]
type Begun<T> = std::thread::JoinHandle<T>;
/// A browser's simulation has one thread: what it begins beside the steps is done when its result is taken, between two of them.
#[cfg(target_family = "wasm")]
type Begun<T> = Box<dyn FnOnce() -> T + Send>;

impl<T: Send + 'static> Background<T> {
    /// Begins it.
    pub(crate) fn begin(work: impl FnOnce() -> T + Send + 'static) -> Self {
        #[cfg(not(target_family = "wasm"))]
        return Self(std::thread::spawn(work));
        #[cfg(target_family = "wasm")]
        Self(Box::new(work))
    }

    /// Waits for what came of it; a panic is an error.
    pub(crate) fn finish(self) -> std::thread::Result<T> {
        #[cfg(not(target_family = "wasm"))]
        return self.0.join();
        #[cfg(target_family = "wasm")]
        Ok((self.0)())
    }
}
