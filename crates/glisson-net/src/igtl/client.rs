//! What one client asked for and what it is sent; without a socket.

use super::frame::{Frame, message, span, timestamp};
use super::messages::{Axes, StatusCode, answer, capability, polydata, status, transform};
use glisson::math::DVec3;
use glisson::tool::ToolInput;
use glisson_runtime::published::Published;
use std::time::{Duration, Instant, SystemTime};

/// The server's own device name.
pub(super) const SERVER_NAME: &str = "Glisson";
/// Least time between two surfaces or sets of poses of one client, unless it asks for fewer: as often as a video.
pub(super) const INTERVAL: Duration = Duration::from_millis(33);
/// Messages of a client in a second above which it is not taken for a viewer.
const MOST_MESSAGES_A_SECOND: u32 = 1_000;

const KINDS: [&str; 12] = [
    "TRANSFORM",
    "POLYDATA",
    "STATUS",
    "CAPABILITY",
    "GET_TRANS",
    "STT_TRANS",
    "STP_TRANS",
    "GET_POLYDATA",
    "STT_POLYDATA",
    "STP_POLYDATA",
    "GET_STATUS",
    "GET_CAPABIL",
];

/// What does not change while the server runs.
#[derive(Clone, Debug)]
pub(crate) struct Described {
    pub(crate) axes: Axes,
    /// Device names of the tools, in the scene's order; at most 20 characters of each are used.
    pub(crate) tool_names: Vec<String>,
    /// Device name of the organ's surface.
    pub(crate) organ_name: String,
}

/// What is displayed now.
#[derive(Clone, Debug)]
pub(super) struct View {
    /// Steps made, by which two views are told apart.
    pub(crate) step: u64,
    pub(crate) poses: Vec<ToolInput>,
    pub(crate) positions_m: Vec<DVec3>,
    pub(crate) triangles: Vec<[u32; 3]>,
}

impl View {
    pub(super) fn of(published: &Published) -> Self {
        let Published { snapshot, topology, .. } = published;
        Self {
            step: snapshot.step,
            poses: snapshot.tools.iter().map(|tool| tool.pose).collect(),
            positions_m: snapshot.positions_m.clone(),
            triangles: topology.triangles.clone(),
        }
    }
}

/// Something that is sent again and again.
#[derive(Clone, Copy, Debug)]
struct Stream {
    /// None: stopped.
    interval: Option<Duration>,
    /// The step that was sent last, and when.
    sent: Option<(u64, Instant)>,
}

impl Stream {
    const RUNNING: Self = Self { interval: Some(INTERVAL), sent: None };

    fn start(&mut self, body: &[u8]) {
        let asked = <[u8; 8]>::try_from(body).map_or(INTERVAL, |body| span(u64::from_be_bytes(body)));
        *self = Self { interval: Some(asked.max(INTERVAL)), sent: None };
    }

    /// Whether it is time to send `step`, which then counts as sent.
    fn takes(&mut self, step: u64, now: Instant) -> bool {
        // A tick that comes a little early still counts.
        let is_due = |last: Instant, interval: Duration| now.duration_since(last) + INTERVAL / 8 >= interval;
        let Some(interval) = self.interval else { return false };
        let takes = self.sent.is_none_or(|(sent, last)| sent != step && is_due(last, interval));
        if takes {
            self.sent = Some((step, now));
        }
        takes
    }
}

/// One client. Streams run unless it begins by asking: 3D Slicer listens without a word; others send a question and take
/// the next message for the answer.
#[derive(Debug)]
pub(super) struct Client {
    described: Described,
    is_greeted: bool,
    transforms: Stream,
    surface: Stream,
    second: Option<Instant>,
    messages_this_second: u32,
}

impl Client {
    pub(super) fn new(described: Described) -> Self {
        let (transforms, surface) = (Stream::RUNNING, Stream::RUNNING);
        Self { described, is_greeted: false, transforms, surface, second: None, messages_this_second: 0 }
    }

    /// Who talks, in which axes and units.
    fn greeting(&self, wall: SystemTime) -> Vec<u8> {
        let axes = self.described.axes.name();
        let sentence = format!("Glisson streams TRANSFORM and POLYDATA in mm, {axes} axes");
        status_message(StatusCode::Ok, &sentence, wall)
    }

    /// What is due now, in one piece; nothing when nothing is.
    pub(super) fn due(&mut self, view: &View, now: Instant, wall: SystemTime) -> Vec<u8> {
        let mut bytes = Vec::new();
        let has_streams = self.transforms.interval.or(self.surface.interval).is_some();
        if has_streams && !std::mem::replace(&mut self.is_greeted, true) {
            bytes.extend(self.greeting(wall));
        }
        if self.transforms.takes(view.step, now) {
            bytes.extend(self.transform_messages(view, wall));
        }
        if self.surface.takes(view.step, now) {
            bytes.extend(self.surface_message(view, wall));
        }
        bytes
    }

    /// The answer to a message; empty for what needs none.
    ///
    /// # Errors
    /// Why the connection should end.
    pub(super) fn hear(
        &mut self,
        frame: &Frame,
        view: &View,
        now: Instant,
        wall: SystemTime,
    ) -> Result<Vec<u8>, String> {
        if self.second.is_none_or(|second| now.duration_since(second) >= Duration::from_secs(1)) {
            self.second = Some(now);
            self.messages_this_second = 0;
        }
        self.messages_this_second += 1;
        if self.messages_this_second > MOST_MESSAGES_A_SECOND {
            return Err(format!("more than {MOST_MESSAGES_A_SECOND} messages in a second"));
        }
        if !self.is_greeted && matches!(frame.kind.as_str(), "GET_TRANS" | "GET_POLYDATA") {
            self.is_greeted = true;
            self.transforms.interval = None;
            self.surface.interval = None;
        }
        let told = |kind: &str, is_done| message(kind, SERVER_NAME, timestamp(wall), &answer(is_done));
        Ok(match frame.kind.as_str() {
            "GET_STATUS" => self.greeting(wall),
            "GET_CAPABIL" => message("CAPABILITY", SERVER_NAME, timestamp(wall), &capability(&KINDS)),
            "GET_TRANS" => match self.tool_asked_for(&frame.device) {
                Some(tools) => tools.flat_map(|tool| self.transform_message(view, tool, wall)).collect(),
                None => {
                    let known = self.described.tool_names.join(", ");
                    let sentence = format!("there is no tool {:?}; there are: {known}", frame.device);
                    status_message(StatusCode::NotFound, &sentence, wall)
                }
            },
            "GET_POLYDATA" => self.surface_message(view, wall),
            "STT_TRANS" => {
                self.transforms.start(&frame.body);
                told("RTS_TRANS", true)
            }
            "STP_TRANS" => {
                self.transforms.interval = None;
                told("RTS_TRANS", true)
            }
            "STT_POLYDATA" => {
                self.surface.start(&frame.body);
                told("RTS_POLYDATA", true)
            }
            "STP_POLYDATA" => {
                self.surface.interval = None;
                told("RTS_POLYDATA", true)
            }
            kind if kind.starts_with("GET_") || kind.starts_with("STT_") || kind.starts_with("STP_") => {
                let sentence = format!("{kind} is not answered; known: {}", KINDS.join(", "));
                status_message(StatusCode::IllegalInstruction, &sentence, wall)
            }
            // What a client sends on its own account (its camera, its status) is nothing to us.
            _ => Vec::new(),
        })
    }

    /// All tools for an empty name.
    fn tool_asked_for(&self, device: &str) -> Option<std::ops::Range<usize>> {
        let names = &self.described.tool_names;
        match names.iter().position(|name| name == device) {
            Some(tool) => Some(tool..tool + 1),
            None => device.is_empty().then_some(0..names.len()),
        }
    }

    fn transform_message(&self, view: &View, tool: usize, wall: SystemTime) -> Vec<u8> {
        let Some(pose) = view.poses.get(tool) else { return Vec::new() };
        let name = self.described.tool_names.get(tool).map_or("tool", String::as_str);
        message("TRANSFORM", name, timestamp(wall), &transform(pose, self.described.axes))
    }

    fn transform_messages(&self, view: &View, wall: SystemTime) -> Vec<u8> {
        (0..view.poses.len()).flat_map(|tool| self.transform_message(view, tool, wall)).collect()
    }

    fn surface_message(&self, view: &View, wall: SystemTime) -> Vec<u8> {
        let body = polydata(&view.positions_m, &view.triangles, self.described.axes);
        message("POLYDATA", &self.described.organ_name, timestamp(wall), &body)
    }
}

/// A STATUS of the server.
pub(super) fn status_message(code: StatusCode, sentence: &str, wall: SystemTime) -> Vec<u8> {
    message("STATUS", SERVER_NAME, timestamp(wall), &status(code, sentence))
}

#[cfg(test)]
mod tests {
    use super::super::frame::HEADER_BYTES;
    use super::*;

    fn client() -> Client {
        let tool_names = vec!["left".to_owned(), "right".to_owned()];
        Client::new(Described { axes: Axes::Ras, tool_names, organ_name: "liver".to_owned() })
    }

    fn view(step: u64) -> View {
        View {
            step,
            poses: vec![ToolInput::at(DVec3::ZERO, DVec3::Z); 2],
            positions_m: vec![DVec3::X, DVec3::Y, DVec3::Z],
            triangles: vec![[0, 1, 2]],
        }
    }

    fn kinds(mut bytes: &[u8]) -> Vec<String> {
        let mut kinds = Vec::new();
        while !bytes.is_empty() {
            let text = |range: std::ops::Range<usize>| {
                String::from_utf8_lossy(&bytes[range]).trim_end_matches('\0').to_owned()
            };
            kinds.push(format!("{} {}", text(2..14), text(14..34)));
            let n_body = u64::from_be_bytes(bytes[42..50].try_into().unwrap()) as usize;
            bytes = &bytes[HEADER_BYTES + n_body..];
        }
        kinds
    }

    fn asks(client: &mut Client, kind: &str, device: &str, body: &[u8]) -> Vec<u8> {
        let frame = Frame { kind: kind.into(), device: device.into(), body: body.to_vec() };
        client.hear(&frame, &view(7), Instant::now(), SystemTime::now()).unwrap()
    }

    #[test]
    fn streams_run_from_the_start_and_send_each_step_once() {
        let (mut client, start, wall) = (client(), Instant::now(), SystemTime::now());
        let all = ["TRANSFORM left", "TRANSFORM right", "POLYDATA liver"];
        let first = kinds(&client.due(&view(1), start, wall));
        assert!(first[0] == "STATUS Glisson" && first[1..] == all, "{first:?}");
        assert!(client.due(&view(1), start + Duration::from_secs(1), wall).is_empty());
        assert!(client.due(&view(2), start + Duration::from_millis(10), wall).is_empty());
        assert_eq!(kinds(&client.due(&view(2), start + Duration::from_secs(1), wall)), all);
        asks(&mut client, "STP_POLYDATA", "", &[]);
        assert_eq!(kinds(&client.due(&view(3), start + Duration::from_secs(2), wall)), all[..2]);
        // Every two seconds, as asked.
        assert_eq!(
            kinds(&asks(&mut client, "STT_POLYDATA", "", &[0, 0, 0, 2, 0, 0, 0, 0])),
            ["RTS_POLYDATA Glisson"]
        );
        asks(&mut client, "STP_TRANS", "", &[]);
        let mut due =
            |step, after_s| kinds(&client.due(&view(step), start + Duration::from_secs(after_s), wall));
        assert_eq!(due(4, 3), all[2..]);
        assert_eq!((due(5, 4).len(), due(6, 5).len()), (0, 1));
    }

    #[test]
    fn questions_are_answered_and_unknown_ones_with_what_is_known() {
        let mut client = client();
        assert_eq!(kinds(&asks(&mut client, "GET_TRANS", "right", &[])), ["TRANSFORM right"]);
        assert_eq!(kinds(&asks(&mut client, "GET_TRANS", "", &[])).len(), 2);
        assert_eq!(kinds(&asks(&mut client, "GET_POLYDATA", "", &[])), ["POLYDATA liver"]);
        assert_eq!(kinds(&asks(&mut client, "GET_CAPABIL", "", &[])), ["CAPABILITY Glisson"]);
        assert!(String::from_utf8_lossy(&asks(&mut client, "GET_STATUS", "", &[])).contains("RAS axes"));
        let unknown = asks(&mut client, "GET_TRANS", "middle", &[]);
        assert!(String::from_utf8_lossy(&unknown).contains("there are: left, right"));
        assert!(String::from_utf8_lossy(&asks(&mut client, "GET_IMAGE", "", &[])).contains("GET_POLYDATA"));
        assert!(asks(&mut client, "TRANSFORM", "camera", &[0; 48]).is_empty());
    }

    #[test]
    fn who_begins_by_asking_gets_answers_only_until_it_asks_for_more() {
        let (mut client, start, wall) = (client(), Instant::now(), SystemTime::now());
        assert_eq!(kinds(&asks(&mut client, "GET_POLYDATA", "", &[])), ["POLYDATA liver"]);
        assert!(client.due(&view(1), start, wall).is_empty());
        asks(&mut client, "STT_TRANS", "", &[]);
        assert_eq!(kinds(&client.due(&view(1), start, wall)).len(), 2);
    }

    #[test]
    fn a_flood_ends_the_connection() {
        let (mut client, now) = (client(), Instant::now());
        let frame = Frame { kind: "TRANSFORM".into(), device: "a".into(), body: Vec::new() };
        let mut hear = |at| client.hear(&frame, &view(0), at, SystemTime::now());
        for _ in 0..MOST_MESSAGES_A_SECOND {
            hear(now).unwrap();
        }
        assert!(hear(now).unwrap_err().contains("1000 messages"));
        assert!(hear(now + Duration::from_secs(1)).is_ok());
    }
}
