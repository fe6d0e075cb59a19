//! How many connections there are at a time, how long one may say nothing, and how often the API answers: whoever reaches the
//! address must not be able to take the server from the viewers.

use super::allowance::Allowance;
use axum::extract::{Request, State};
use axum::http::{StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use axum::serve::Listener;
use std::io;
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};
use tokio::io::{AsyncRead, AsyncReadExt, AsyncWrite, AsyncWriteExt, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Sleep, sleep, timeout};

/// Connections at a time: those of all viewers, and as many again that ask for the page and the API. A choice.
pub(super) const MOST_CONNECTIONS: usize = 128;
/// One over which nothing comes or goes for so long is closed; a viewer is pinged every second, and answers. A choice.
const LONGEST_QUIET: Duration = Duration::from_secs(30);
/// Until the next attempt when the system has no socket left.
const PAUSE: Duration = Duration::from_millis(100);

const ALL_TAKEN: &[u8] =
    b"HTTP/1.1 503 Service Unavailable\r\nContent-Type: text/plain\r\nContent-Length: 32\r\n\
    Retry-After: 1\r\nConnection: close\r\n\r\nall connections are taken (128)\n";

/// Connections beyond them that are told so at a time, and how long that may take; more are closed without a word. The same holds
/// for those that have ended and may still read why.
const MOST_DISMISSED: usize = 16;
const DISMISSING: Duration = Duration::from_secs(1);

/// Accepts so many connections at a time; tells those beyond them that all are taken.
pub(crate) struct Places {
    listener: TcpListener,
    free: Arc<Semaphore>,
    dismissed: Arc<Semaphore>,
    longest_quiet: Duration,
}

impl Places {
    pub(crate) fn new(listener: TcpListener) -> Self {
        let [free, dismissed] = [MOST_CONNECTIONS, MOST_DISMISSED].map(|n| Arc::new(Semaphore::new(n)));
        Self { listener, free, dismissed, longest_quiet: LONGEST_QUIET }
    }

    fn dismiss(&self, mut stream: TcpStream) {
        let Ok(turn) = Arc::clone(&self.dismissed).try_acquire_owned() else { return };
        tokio::spawn(async move {
            let tell = async {
                stream.write_all(ALL_TAKEN).await?;
                hear_out(&mut stream).await
            };
            // Whether it hears it is its own affair.
            let _ = timeout(DISMISSING, tell).await;
            drop(turn);
        });
    }
}

/// Says that nothing follows, and reads to the end: what is closed with something unread is reset, and what was said last is lost.
async fn hear_out(stream: &mut TcpStream) -> io::Result<()> {
    stream.shutdown().await?;
    let mut unread = [0; 1 << 10];
    while stream.read(&mut unread).await? > 0 {}
    Ok(())
}

impl Listener for Places {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        loop {
            match self.listener.accept().await {
                Ok((stream, address)) => match Arc::clone(&self.free).try_acquire_owned() {
                    Ok(place) => {
                        let quiet = Box::pin(sleep(self.longest_quiet));
                        let longest_quiet = self.longest_quiet;
                        let dismissed = Arc::clone(&self.dismissed);
                        let stream = Some(stream);
                        return (
                            Connection { stream, quiet, longest_quiet, dismissed, _place: place },
                            address,
                        );
                    }
                    Err(_) => self.dismiss(stream),
                },
                // Of a client that is gone already.
                Err(error) if is_of_client(&error) => {}
                // Of the system, which may pass.
                Err(_) => sleep(PAUSE).await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

fn is_of_client(error: &io::Error) -> bool {
    use io::ErrorKind::{ConnectionAborted, ConnectionRefused, ConnectionReset};
    matches!(error.kind(), ConnectionAborted | ConnectionRefused | ConnectionReset)
}

/// One connection; its place is free again when it ends.
pub(crate) struct Connection {
    /// Until it is dropped.
    stream: Option<TcpStream>,
    quiet: Pin<Box<Sleep>>,
    longest_quiet: Duration,
    dismissed: Arc<Semaphore>,
    _place: OwnedSemaphorePermit,
}

impl Drop for Connection {
    fn drop(&mut self) {
        // Where the server ends, so does this.
        let Ok(runtime) = tokio::runtime::Handle::try_current() else { return };
        let Ok(turn) = Arc::clone(&self.dismissed).try_acquire_owned() else { return };
        if let Some(mut stream) = self.stream.take() {
            runtime.spawn(async move {
                // Whether it hears it is its own affair.
                let _ = timeout(DISMISSING, hear_out(&mut stream)).await;
                drop(turn);
            });
        }
    }
}

impl Connection {
    fn stream(&mut self) -> Pin<&mut TcpStream> {
        Pin::new(self.stream.as_mut().expect("it is taken when the connection is dropped, not before"))
    }

    /// Something came or went, or it is too long ago that something did.
    fn look<T>(&mut self, context: &mut Context<'_>, polled: Poll<io::Result<T>>) -> Poll<io::Result<T>> {
        if polled.is_ready() {
            self.quiet.as_mut().reset(tokio::time::Instant::now() + self.longest_quiet);
            return polled;
        }
        self.quiet.as_mut().poll(context).map(|()| Err(io::ErrorKind::TimedOut.into()))
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        let polled = self.stream().poll_read(context, buffer);
        self.look(context, polled)
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let polled = self.stream().poll_write(context, bytes);
        self.look(context, polled)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
        parts: &[io::IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let polled = self.stream().poll_write_vectored(context, parts);
        self.look(context, polled)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.as_ref().is_some_and(TcpStream::is_write_vectored)
    }

    fn poll_flush(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream().poll_flush(context)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        self.stream().poll_shutdown(context)
    }
}

/// What the API may still be asked, by all together.
pub(crate) struct Asked(Mutex<Allowance>);

impl Default for Asked {
    fn default() -> Self {
        Self(Mutex::new(Allowance::new(Instant::now())))
    }
}

/// Answers questions to the API as often as a viewer may say something.
pub(crate) async fn guard_api(State(asked): State<Arc<Asked>>, request: Request, next: Next) -> Response {
    let n_bytes = request.uri().path().len();
    // Its numbers hold also after a panic.
    let may = asked.0.lock().unwrap_or_else(PoisonError::into_inner).spend(n_bytes, Instant::now());
    if may {
        return next.run(request).await;
    }
    let text = "the API was asked too often: at most 600 times a second in the long run\n";
    (StatusCode::TOO_MANY_REQUESTS, [(header::RETRY_AFTER, "1")], text).into_response()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_answer_without_a_place_is_as_long_as_it_says_and_names_how_many_there_are() {
        let text = String::from_utf8(ALL_TAKEN.to_vec()).unwrap();
        let (head, body) = text.split_once("\r\n\r\n").unwrap();
        assert!(head.contains(&format!("Content-Length: {}\r\n", body.len())), "{text}");
        assert!(body.contains(&format!("({MOST_CONNECTIONS})")), "{text}");
    }

    #[tokio::test]
    async fn a_connection_that_says_nothing_is_closed_and_one_that_talks_is_not() {
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        let address = listener.local_addr().unwrap();
        let mut places = Places { longest_quiet: Duration::from_millis(200), ..Places::new(listener) };
        let mut client = TcpStream::connect(address).await.unwrap();
        let (mut connection, _) = places.accept().await;
        let mut byte = [0];
        for _ in 0..4 {
            client.write_all(&[7]).await.unwrap();
            assert_eq!(connection.read(&mut byte).await.unwrap(), 1);
            tokio::time::sleep(Duration::from_millis(80)).await;
        }
        let end = connection.read(&mut byte).await.unwrap_err();
        assert_eq!(end.kind(), io::ErrorKind::TimedOut);
        drop(connection);
        assert_eq!(places.free.available_permits(), MOST_CONNECTIONS);
    }
}
