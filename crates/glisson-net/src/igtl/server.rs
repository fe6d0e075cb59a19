//! The server's sockets: a thread of its own, so that no client delays the viewer or the simulation.

use super::client::{Client, Described, INTERVAL, View, status_message};
use super::frame::{FrameError, FrameReader};
use super::messages::StatusCode;
use anyhow::{Context, anyhow};
use glisson_runtime::published::Published;
use std::net::{SocketAddr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use std::time::{Duration, Instant, SystemTime};
use tokio::io::{AsyncReadExt, AsyncWriteExt};
use tokio::net::TcpStream;
use tokio::sync::{Semaphore, watch};
use tokio::time::timeout;

/// Clients at a time.
const MOST_CLIENTS: usize = 8;
/// A client that takes nothing for so long is dropped: what it has not read is kept for it by the system only up to a
/// limit.
const PATIENCE: Duration = Duration::from_secs(5);

/// How long a client may take to ask before it is told without being asked.
const GRACE: Duration = Duration::from_millis(200);

/// Takes the address.
pub(crate) fn bind(address: SocketAddr) -> anyhow::Result<TcpListener> {
    let listener = TcpListener::bind(address).map_err(|e| match e.kind() {
        std::io::ErrorKind::AddrInUse => {
            anyhow!(
                "{address} is in use (another OpenIGTLink server?); give another one: --igtl ADDRESS:PORT"
            )
        }
        _ => anyhow!("cannot listen for OpenIGTLink on {address}: {e}"),
    })?;
    listener.set_nonblocking(true)?;
    Ok(listener)
}

/// Serves until the sender of `published` is gone.
pub(crate) fn spawn(
    listener: TcpListener,
    described: Described,
    published: watch::Receiver<Arc<Published>>,
) -> anyhow::Result<JoinHandle<()>> {
    let runtime = tokio::runtime::Builder::new_current_thread().enable_all().build()?;
    let thread = std::thread::Builder::new().name("openigtlink".into()).spawn(move || {
        if let Err(error) = runtime.block_on(accept(listener, &described, published)) {
            eprintln!("OpenIGTLink: {error:#}");
        }
    })?;
    Ok(thread)
}

async fn accept(
    listener: TcpListener,
    described: &Described,
    published: watch::Receiver<Arc<Published>>,
) -> anyhow::Result<()> {
    let listener = tokio::net::TcpListener::from_std(listener).context("the listening socket")?;
    let places = Arc::new(Semaphore::new(MOST_CLIENTS));
    let mut clients = tokio::task::JoinSet::new();
    let mut alive = published.clone();
    loop {
        let accepted = tokio::select! {
            accepted = listener.accept() => accepted,
            () = async { while alive.changed().await.is_ok() {} } => break,
        };
        // A client that is gone before it was accepted is no reason to stop.
        let Ok((mut stream, address)) = accepted else { continue };
        let Ok(place) = Arc::clone(&places).try_acquire_owned() else {
            let sentence = format!("{MOST_CLIENTS} clients are connected already");
            let busy = status_message(StatusCode::Busy, &sentence, SystemTime::now());
            let _ = timeout(PATIENCE, stream.write_all(&busy)).await;
            continue;
        };
        let client = Client::new(described.clone());
        let published = published.clone();
        clients.spawn(async move {
            if let Err(reason) = talk(&mut stream, client, published).await {
                eprintln!("OpenIGTLink: {address} was dropped: {reason}");
            }
            drop(place);
        });
        // Those that ended.
        while clients.try_join_next().is_some() {}
    }
    while clients.join_next().await.is_some() {}
    Ok(())
}

fn code_of(error: &FrameError) -> StatusCode {
    match error {
        FrameError::Crc { .. } => StatusCode::Checksum,
        FrameError::Size { .. } => StatusCode::Overflow,
        FrameError::Version(_) | FrameError::Name(_) => StatusCode::IllegalInstruction,
    }
}

async fn send(stream: &mut TcpStream, bytes: &[u8]) -> Result<(), String> {
    match timeout(PATIENCE, stream.write_all(bytes)).await {
        Ok(written) => written.map_err(|e| e.to_string()),
        Err(_) => Err(format!("it read nothing for {} s", PATIENCE.as_secs())),
    }
}

/// Tells the reason, then leaves.
async fn dismiss(stream: &mut TcpStream, code: StatusCode, reason: String) -> Result<(), String> {
    let told = status_message(code, &reason, SystemTime::now());
    // Whether it hears it is its own affair.
    let _ = send(stream, &told).await;
    let _ = stream.shutdown().await;
    Err(reason)
}

/// Until the client leaves, is dropped (then the reason is the error), or the simulation ends.
async fn talk(
    stream: &mut TcpStream,
    mut client: Client,
    mut published: watch::Receiver<Arc<Published>>,
) -> Result<(), String> {
    // Poses are small and must not wait for more.
    let _ = stream.set_nodelay(true);
    let mut reader = FrameReader::default();
    let mut buffer = vec![0; 1 << 14];
    let mut tick = tokio::time::interval_at(tokio::time::Instant::now() + GRACE, INTERVAL);
    tick.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
    loop {
        tokio::select! {
            read = stream.read(&mut buffer) => match read {
                Ok(0) => return Ok(()),
                Ok(n) => {
                    reader.push(&buffer[..n]);
                    loop {
                        let frame = match reader.next() {
                            Ok(Some(frame)) => frame,
                            Ok(None) => break,
                            Err(error) => return dismiss(stream, code_of(&error), error.to_string()).await,
                        };
                        let latest = Arc::clone(&published.borrow());
                        let view = View::of(&latest);
                        match client.hear(&frame, &view, Instant::now(), SystemTime::now()) {
                            Ok(answer) => send(stream, &answer).await?,
                            Err(reason) => return dismiss(stream, StatusCode::Overflow, reason).await,
                        }
                    }
                }
                // It is gone without a word.
                Err(_) => return Ok(()),
            },
            _ = tick.tick() => {
                let latest = Arc::clone(&published.borrow_and_update());
                let view = View::of(&latest);
                let bytes = client.due(&view, Instant::now(), SystemTime::now());
                send(stream, &bytes).await?;
            }
            () = ended(published.clone()) => {
                let sentence = "the simulation ends".to_owned();
                let _ = dismiss(stream, StatusCode::ShuttingDown, sentence).await;
                return Ok(());
            }
        }
    }
}

async fn ended(mut published: watch::Receiver<Arc<Published>>) {
    while published.changed().await.is_ok() {}
}
