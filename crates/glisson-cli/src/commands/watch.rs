//! `glisson watch`.

use anyhow::{Context, bail};
use serde_json::json;
use std::net::TcpStream;
use std::time::{Duration, Instant};
use tungstenite::{Message, client::IntoClientRequest};

/// Connect to a running server as a viewer without a window, and count what arrives.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  glisson watch                                    until the server ends\n  \
    glisson watch ws://127.0.0.1:8077/ws --seconds 5 --json\n  \
    glisson watch 'ws://10.0.0.7:8077/ws?token=...'   a server on another address"
)]
pub(crate) struct Args {
    /// Address of the server's WebSocket
    #[arg(default_value = "ws://127.0.0.1:8077/ws")]
    address: String,
    /// Stop after so many seconds
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Print the summary as JSON
    #[arg(long)]
    json: bool,
}

/// A server that says nothing for so long is gone: it tells its timing every second.
const LONGEST_SILENCE: Duration = Duration::from_secs(10);

/// The fifth bytes of frames (`docs/protocol.md`).
const KIND_TOPOLOGY: u8 = 1;
const KIND_SNAPSHOT: u8 = 2;

pub(crate) fn run(args: &Args) -> anyhow::Result<()> {
    let request = args
        .address
        .as_str()
        .into_client_request()
        .with_context(|| format!("\"{}\" is no address; use ws://HOST:PORT/ws", args.address))?;
    let uri = request.uri().clone();
    let (Some("ws"), Some(host)) = (uri.scheme_str(), uri.host()) else {
        bail!("\"{}\": only ws://HOST:PORT/ws can be watched", args.address);
    };
    let host = host.trim_start_matches('[').trim_end_matches(']');
    let port = uri.port_u16().unwrap_or(80);
    let stream = TcpStream::connect((host, port))
        .with_context(|| format!("{host} port {port}: nobody answers; is `glisson serve` running there?"))?;
    stream.set_read_timeout(Some(LONGEST_SILENCE))?;
    let (mut socket, _) = tungstenite::client(request, stream)
        .map_err(|e| anyhow::anyhow!("{host} port {port}: the server refused: {e}"))?;
    let start = Instant::now();
    let (mut frames, mut bytes, mut bytes_of_frames) = (0_u64, 0_u64, 0_u64);
    let mut timing = serde_json::Value::Null;
    while args.seconds.is_none_or(|seconds| start.elapsed().as_secs_f64() < seconds) {
        match socket.read() {
            Ok(Message::Binary(frame)) => {
                let kind = frame.get(4);
                bytes += frame.len() as u64;
                frames += u64::from(kind == Some(&KIND_SNAPSHOT));
                // With what their positions are differences from.
                bytes_of_frames += if kind == Some(&KIND_TOPOLOGY) { 0 } else { frame.len() as u64 };
            }
            Ok(Message::Text(text)) => {
                bytes += text.len() as u64;
                let message: serde_json::Value =
                    serde_json::from_str(&text).context("the server sent text that is no JSON")?;
                match message["type"].as_str() {
                    Some("timing") => timing = message,
                    Some("error" | "news") if !args.json => {
                        println!("{}", message["message"].as_str().unwrap_or_default());
                    }
                    _ => {}
                }
            }
            Ok(_) => {}
            // The server ended.
            Err(_) => break,
        }
    }
    let elapsed_s = start.elapsed().as_secs_f64();
    if args.json {
        println!(
            "{}",
            json!({ "frames": frames, "bytes": bytes, "bytes_of_frames": bytes_of_frames, "elapsed_s": elapsed_s, "timing": timing })
        );
    } else {
        let frames_per_s = frames as f64 / elapsed_s;
        println!(
            "{frames} frames in {elapsed_s:.1} s ({frames_per_s:.1} a second), {:.1} MB",
            bytes as f64 * 1e-6
        );
        println!("{timing:#}");
    }
    Ok(())
}
