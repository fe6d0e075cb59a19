use super::*;
use glisson::math::SeededRandom;

/// Made by an independent program (Python's `struct` and `binascii.crc_hqx`).
const GREETING_BYTES: [u8; 10] = [0xA5, 0x5A, 0x01, 0x01, 0x00, 0x00, 0x00, 0x00, 0xE1, 0xE1];
const OUTPUTS_BYTES: [u8; 21] = [
    0xA5, 0x5A, 0x01, 0x02, 0x03, 0x0B, 0x34, 0x12, 0x01, 0x00, 0xFF, 0xFF, 0xFF, 0x7F, 0x00, 0x80, 0x00,
    0x01, 0x01, 0xBC, 0x06,
];
const STATE_BYTES: [u8; 62] = [
    0xA5, 0x5A, 0x01, 0x82, 0x01, 0x34, 0xFF, 0xFF, 0x04, 0x03, 0x02, 0x01, 0x03, 0x00, 0x01, 0x00, 0x00,
    0x00, 0xFE, 0xFF, 0xFF, 0xFF, 0xB8, 0x0B, 0x00, 0x00, 0xFC, 0xFF, 0xFF, 0xFF, 0x05, 0x00, 0x00, 0x00,
    0x00, 0x00, 0x00, 0x00, 0xFF, 0xFF, 0xFF, 0xFF, 0x70, 0x11, 0x01, 0x00, 0x09, 0x00, 0x00, 0x00, 0x90,
    0xEE, 0xFE, 0xFF, 0x17, 0x01, 0x34, 0x12, 0xAB, 0x02, 0x3D, 0x92,
];

fn outputs() -> Frame {
    let outputs = Outputs { levels: [1, -1, 32767, -32768, 256], is_enabled: true };
    Frame { trocar: 3, sequence: 0x1234, message: Message::Outputs(outputs) }
}

fn state() -> Frame {
    let state = State {
        time_us: 0x0102_0304,
        flags: flags::PRESENT | flags::ENABLED,
        encoders: EncoderSample {
            counts: [1, -2, 3000, -4, 5],
            mark_counts: [0, -1, 70_000, 9, -70_000],
            is_marked: [true, true, true, false, true],
        },
        tag: [1, 0x34, 0x12, 0xAB],
        buttons: 2,
    };
    Frame { trocar: 1, sequence: 0xFFFF, message: Message::State(state) }
}

fn all_of(decoder: &mut FrameDecoder) -> Vec<Result<Frame, FrameError>> {
    std::iter::from_fn(|| decoder.next_frame()).collect()
}

fn decode(bytes: &[u8]) -> Vec<Result<Frame, FrameError>> {
    let mut decoder = FrameDecoder::new();
    let mut found = Vec::new();
    for part in bytes.chunks(200) {
        assert_eq!(decoder.push(part), part.len());
        found.extend(all_of(&mut decoder));
    }
    found
}

#[test]
fn frames_have_the_bytes_of_the_description() {
    assert_eq!(check_of(b"123456789"), 0x29B1);
    let greeting = Frame { trocar: 0, sequence: 0, message: Message::Greeting };
    for (frame, bytes) in
        [(greeting, &GREETING_BYTES[..]), (outputs(), &OUTPUTS_BYTES[..]), (state(), &STATE_BYTES[..])]
    {
        assert_eq!(frame.to_bytes().as_slice(), bytes);
        assert_eq!(decode(bytes), [Ok(frame)]);
    }
    let identity = Identity { profile: 2, firmware: 7, serial: 0xDEAD_BEEF, rate_hz: 1500 };
    for message in [Message::Identity(identity), Message::Stop, Message::Refusal(4)] {
        let frame = Frame { trocar: 2, sequence: 9, message };
        assert_eq!(decode(frame.to_bytes().as_slice()), [Ok(frame)]);
    }
}

#[test]
fn a_stream_is_read_in_any_parts() {
    let stream = [&OUTPUTS_BYTES[..], &STATE_BYTES[..], &GREETING_BYTES[..], &STATE_BYTES[..]].concat();
    for size in [1, 2, 3, 7, 64, stream.len()] {
        let mut decoder = FrameDecoder::new();
        let mut found = Vec::new();
        for part in stream.chunks(size) {
            assert_eq!(decoder.push(part), part.len());
            found.extend(all_of(&mut decoder));
        }
        assert_eq!(found.len(), 4);
        assert!(found.iter().all(Result::is_ok));
    }
}

/// `bytes` with the check that belongs to them.
fn checked(mut bytes: Vec<u8>) -> Vec<u8> {
    let end = bytes.len() - 2;
    let check = check_of(&bytes[2..end]).to_le_bytes();
    bytes[end..].copy_from_slice(&check);
    bytes
}

#[test]
fn bad_frames_are_refused_with_a_reason_and_the_next_one_is_found() {
    let with = |place: usize, byte: u8| {
        let mut bytes = OUTPUTS_BYTES.to_vec();
        bytes[place] = byte;
        bytes
    };
    let cases: [(Vec<u8>, FrameError, &str); 8] = [
        (vec![1, 2, 3], FrameError::Noise { n_bytes: 3 }, "3 bytes before A5 5A, where a frame begins"),
        (with(2, 9), FrameError::Version { found: 9 }, "protocol version 9; this program speaks 1"),
        (with(5, 65), FrameError::Length { found: 65 }, "a payload of 65 bytes; 64 at most"),
        (
            checked(with(3, 0x55)),
            FrameError::Kind { found: 0x55 },
            "a message of kind 0x55, which there is not",
        ),
        (checked(with(4, 4)), FrameError::Trocar { found: 4 }, "trocar 4; 0 to 3 on a line"),
        (
            checked(with(3, STATE)),
            FrameError::PayloadLength { kind: STATE, found: 11, wanted: 52 },
            "a message of kind 0x82 with 11 bytes; it has 52",
        ),
        (
            checked(with(18, 2)),
            FrameError::Value { what: "\"amplifiers on\" is", found: 2, most: 1 },
            "\"amplifiers on\" is 2; 0 to 1",
        ),
        (
            with(8, 0),
            FrameError::Check { found: 0x06BC, wanted: check_of(&with(8, 0)[2..19]) },
            "they were changed on the way",
        ),
    ];
    for (bytes, error, text) in cases {
        let found = decode(&[&bytes[..], &STATE_BYTES[..]].concat());
        assert_eq!(found.first(), Some(&Err(error)));
        assert!(error.to_string().ends_with(text), "{error}");
        assert_eq!(found.last(), Some(&Ok(state())), "{error}");
        assert!((1..=8).contains(&error.code()));
    }
}

#[test]
fn every_changed_bit_of_a_frame_is_found() {
    for bit in 0..8 * STATE_BYTES.len() {
        let mut bytes = STATE_BYTES;
        bytes[bit / 8] ^= 1 << (bit % 8);
        let found = decode(&[&bytes[..], &STATE_BYTES[..]].concat());
        let n_good = found.iter().filter(|f| f.is_ok()).count();
        assert_eq!((n_good, found.last()), (1, Some(&Ok(state()))), "bit {bit}: {found:?}");
    }
}

#[test]
fn random_and_mutated_bytes_never_panic_and_good_frames_come_through() {
    let mut random = SeededRandom::new(41);
    let mut below = |n: usize| (random.next_u64() % n as u64) as usize;
    let mut decoder = FrameDecoder::new();
    let (mut n_good, mut n_bad) = (0, 0);
    for _ in 0..20_000 {
        let mut bytes = match below(4) {
            0 => (0..below(100)).map(|_| below(256) as u8).collect(),
            1 => OUTPUTS_BYTES.to_vec(),
            2 => STATE_BYTES.to_vec(),
            // Headers that promise much.
            _ => vec![0xA5, 0x5A, VERSION, below(256) as u8, below(6) as u8, below(80) as u8],
        };
        for _ in 0..below(3) {
            if !bytes.is_empty() {
                let place = below(bytes.len());
                bytes[place] = below(256) as u8;
            }
        }
        bytes.truncate(bytes.len() - below(bytes.len() + 1) * usize::from(below(10) == 0));
        assert_eq!(decoder.push(&bytes), bytes.len(), "there is room after all frames were taken");
        for found in all_of(&mut decoder) {
            match found {
                Ok(_) => n_good += 1,
                Err(error) => {
                    n_bad += 1;
                    assert!(!error.to_string().is_empty());
                }
            }
        }
    }
    assert!(n_good > 2_000 && n_bad > 10_000, "{n_good} good, {n_bad} bad");
    // Whatever came before, a frame is found at the latest when what was promised has come.
    let quiet = [0; MOST_FRAME_BYTES];
    assert_eq!(decoder.push(&quiet), quiet.len());
    all_of(&mut decoder);
    decoder.push(&STATE_BYTES);
    assert_eq!(all_of(&mut decoder).last(), Some(&Ok(state())));
}
