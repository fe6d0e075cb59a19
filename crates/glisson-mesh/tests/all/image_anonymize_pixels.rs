//! The pixels of copies of DICOM without the patient, and what is said of them.

use dicom_core::value::PixelFragmentSequence;
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::{tags, uids};
use dicom_object::{DefaultDicomObject, InMemDicomObject, open_file};
use glisson_mesh::image::files::{SeriesChoice, anonymize};

use super::image_anonymize::{CT, SECRET, element, number, save, slice};

/// The copy of a slice that is changed, with its notes; or the message of a refusal.
fn copy_of(
    syntax: &str,
    change: impl FnOnce(&mut InMemDicomObject),
) -> Result<(DefaultDicomObject, Vec<String>), String> {
    let folder = tempfile::tempdir().unwrap();
    let mut object = slice(0, "4");
    object.put(element(tags::PIXEL_DATA, VR::OW, PrimitiveValue::U16([1, 2, 3, 4].as_slice().into())));
    change(&mut object);
    let (path, out) = (folder.path().join("a.dcm"), folder.path().join("out"));
    save(object, syntax, &path);
    let done = anonymize(&path, &SeriesChoice::Only, &out, [7; 32]).map_err(|error| error.to_string())?;
    Ok((open_file(out.join("slice_0001.dcm")).unwrap(), done.notes))
}

fn stream_copy(syntax: &str, fragments: Vec<Vec<u8>>) -> Result<Vec<u8>, String> {
    let (object, _) = copy_of(syntax, |object| {
        let fragments = PixelFragmentSequence::new_fragments(fragments);
        object.put(DataElement::new(tags::PIXEL_DATA, VR::OB, fragments));
    })?;
    Ok(object.element(tags::PIXEL_DATA).unwrap().fragments().unwrap().concat())
}

fn has_secret(bytes: &[u8]) -> bool {
    bytes.windows(4).any(|window| SECRET.as_bytes().windows(4).any(|part| part == window))
}

fn segment(marker: u8, payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u16 + 2).to_be_bytes();
    [&[0xff, marker], &length[..], payload].concat()
}

const SOI: &[u8] = &[0xff, 0xd8];
const EOI: &[u8] = &[0xff, 0xd9];

/// The least that a JPEG stream is made of.
fn jpeg() -> Vec<u8> {
    [SOI, &segment(0xda, &[1, 2, 3]), &[0x12, 0x34], EOI].concat()
}

#[test]
fn streams_that_are_not_of_their_coding_are_refused() {
    let jp2 = [&b"\0\0\0\x0cjP  \r\n\x87\n"[..], SECRET.as_bytes(), &[0xff, 0x4f, 0xff, 0x51]].concat();
    let before = [SECRET.as_bytes(), &jpeg()].concat();
    let between = [SOI, SECRET.as_bytes(), &jpeg()[2..]].concat();
    let begins = ["PixelData", "a stream that does not begin as its transfer syntax says", "gdcmconv"];
    let damaged = ["PixelData", "damaged, or goes on behind its end", "gdcmconv"];
    for (syntax, fragments, words) in [
        (uids::JPEG2000_LOSSLESS, vec![jp2], begins),
        (uids::JPEG_LOSSLESS_SV1, vec![before.clone()], begins),
        (uids::JPEGLS_LOSSLESS, vec![before], begins),
        (uids::JPEG2000, vec![jpeg()], begins),
        (uids::JPEG_BASELINE8_BIT, vec![between], damaged),
        (uids::JPEG_BASELINE8_BIT, vec![jpeg()[..jpeg().len() - 2].to_vec()], damaged),
        // A second frame that does not begin with SOI is not part of the first.
        (uids::JPEG_BASELINE8_BIT, vec![jpeg(), SECRET.as_bytes().to_vec()], damaged),
        (uids::RLE_LOSSLESS, vec![SECRET.as_bytes().repeat(9)], damaged),
        (
            uids::EXPLICIT_VR_LITTLE_ENDIAN,
            vec![jpeg()],
            ["PixelData", "in fragments", "words, as the transfer syntax says"],
        ),
    ] {
        let message = stream_copy(syntax, fragments).unwrap_err();
        assert!(words.iter().all(|word| message.contains(word)), "{syntax}: {message}");
        assert!(!message.contains("Zzyzx"), "{message}");
    }
    let words = copy_of(uids::JPEG_LOSSLESS_SV1, |_| {}).unwrap_err();
    assert!(words.contains("not in fragments"), "{words}");
    let text = copy_of(uids::EXPLICIT_VR_LITTLE_ENDIAN, |object| {
        object.put(element(tags::PIXEL_DATA, VR::LT, SECRET));
    });
    let text = text.unwrap_err();
    assert!(text.contains("words of pixels (OB, OW or OL)") && !text.contains("Zzyzx"), "{text}");
}

#[test]
fn what_compressed_streams_need_not_have_is_cleared() {
    let secret = SECRET.as_bytes();
    // Reserved segments of JPEG.
    let reserved = [0x80, 0xbf, 0xc8, 0xf0, 0xf6, 0xf9, 0xfd].map(|marker| segment(marker, secret)).concat();
    let stream = [SOI, &reserved, &segment(0xf7, b"kept"), &jpeg()[2..]].concat();
    let copied = stream_copy(uids::JPEGLS_LOSSLESS, vec![stream.clone()]).unwrap();
    assert!(!has_secret(&copied) && copied.len().abs_diff(stream.len()) < 2);
    assert!(copied.windows(4).any(|window| window == b"kept"));
    // A part of a tile that goes to the end (Psot 0), with a packet whose number looks like the end.
    let coded = [0xff, 0x93, 0xff, 0x91, 0, 4, 0xff, 0xd9, 0x12, 0x34, 0xff, 0x7f];
    let stream = [
        &[0xff, 0x4f][..],
        &segment(0x51, &[0; 39]),
        &segment(0x6f, secret),
        &segment(0x90, &[0, 0, 0, 0, 0, 0, 0, 1]),
        &coded,
        &[0xff, 0xd9],
        secret,
    ]
    .concat();
    let copied = stream_copy(uids::JPEG2000_LOSSLESS, vec![stream]).unwrap();
    assert!(!has_secret(&copied) && copied.windows(coded.len()).any(|window| window == coded));
    // RLE: two segments of four pixels, something in the header and behind each.
    let (high, low) = ([0xfd, 0], [1, 7, 8, 0xff, 9]);
    let mut header = [2u32, 64, 64 + 2 + secret.len() as u32].map(u32::to_le_bytes).concat();
    header.extend_from_slice(secret);
    header.resize(64, 0);
    let stream = [&header[..], &high, secret, &low, secret].concat();
    let copied = stream_copy(uids::RLE_LOSSLESS, vec![stream]).unwrap();
    assert!(!has_secret(&copied), "{copied:?}");
    let nothing = vec![0x80; secret.len()];
    assert_eq!(copied[64..64 + 2 + secret.len() + 5], [&high, &nothing[..], &low].concat());
}

/// The pixels of a copy as bytes, of an image of some columns and two rows.
fn pixels(
    syntax: &str,
    columns: u16,
    bits: [u16; 2],
    vr: VR,
    words: PrimitiveValue,
) -> (Vec<u8>, Vec<String>) {
    let (object, notes) = copy_of(syntax, |object| {
        object.put(number(tags::COLUMNS, columns));
        object.put(number(tags::BITS_ALLOCATED, bits[0]));
        object.put(number(tags::BITS_STORED, bits[1]));
        object.put(number(tags::HIGH_BIT, bits[1] - 1));
        object.put(element(tags::PIXEL_DATA, vr, words));
    })
    .unwrap();
    (object.element(tags::PIXEL_DATA).unwrap().to_bytes().unwrap().into_owned(), notes)
}

#[test]
fn unused_bits_of_every_word_are_cleared_and_told() {
    let (explicit, big_endian) = (uids::EXPLICIT_VR_LITTLE_ENDIAN, "1.2.840.10008.1.2.2");
    let told = |notes: &[String], n: usize| {
        notes.iter().any(|note| note.contains(&format!("in 1 file(s) {n} pixel(s) had something in bits")))
    };
    // 32 bits, of which 20 are used; as words of 16 bits in big-endian files the high one stands first.
    let (low, high) = (0x5678u16, 0xabc4u16);
    let (found, notes) =
        pixels(explicit, 1, [32, 20], VR::OW, PrimitiveValue::U16([low, high, low, 0].as_slice().into()));
    assert_eq!(found, [0x78, 0x56, 0x04, 0, 0x78, 0x56, 0, 0]);
    assert!(told(&notes, 1), "{notes:?}");
    let (found, _) =
        pixels(big_endian, 1, [32, 20], VR::OW, PrimitiveValue::U16([high, low, 0, low].as_slice().into()));
    assert_eq!(found, [0x04, 0, 0x78, 0x56, 0, 0, 0x78, 0x56]);
    // Two pixels of 8 bits a word, six bits used; the last byte is nobody's.
    let words = PrimitiveValue::U16([0xc1c2, 0x0304, 0x45c6, 0xff07, 0xffff].as_slice().into());
    let (found, notes) = pixels(explicit, 3, [8, 6], VR::OW, words);
    assert_eq!(found, [0x02, 0x01, 0x04, 0x03, 0x06, 0x05]);
    assert!(told(&notes, 4), "{notes:?}");
    // Ten pixels of a bit in a word.
    let (found, _) = pixels(explicit, 5, [1, 1], VR::OW, PrimitiveValue::U16([0xfffe].as_slice().into()));
    assert_eq!(found, [0xfe, 0x03]);
    // Pixels that fill no whole number of the words that they are written in.
    let words = PrimitiveValue::U32([0x0403_0201, 0xffff_0605, 0xffff_ffff].as_slice().into());
    let (found, notes) = pixels(explicit, 3, [8, 8], VR::OL, words);
    assert_eq!(found, [1, 2, 3, 4, 5, 6, 0, 0]);
    assert!(notes.is_empty(), "{notes:?}");
    // A sign that goes on is no change, one that does not is.
    for (word, n_changed) in [(0xf800u16, 0), (0x0800, 1)] {
        let (object, notes) = copy_of(explicit, |object| {
            object.put(number(tags::PIXEL_REPRESENTATION, 1));
            object.put(element(
                tags::PIXEL_DATA,
                VR::OW,
                PrimitiveValue::U16([word, 1, 2, 3].as_slice().into()),
            ));
        })
        .unwrap();
        assert_eq!(object.element(tags::PIXEL_DATA).unwrap().to_multi_int::<u16>().unwrap()[0], 0xf800);
        assert_eq!(told(&notes, 1), n_changed == 1, "{notes:?}");
    }
}

/// Storage class, values of ImageType, BurnedInAnnotation, and what is warned of.
type Case<'a> = (&'a str, &'a [&'a str], Option<&'a str>, Option<&'a str>);

#[test]
fn pixels_that_may_tell_the_patient_are_warned_of_and_the_copy_says_so() {
    let us = uids::ULTRASOUND_IMAGE_STORAGE;
    let cases: [Case<'_>; 13] = [
        (CT, &["ORIGINAL", "PRIMARY"], None, None),
        (CT, &["DERIVED", "SECONDARY"], None, Some("do not say whether")),
        (CT, &["DERIVED", "SECONDARY"], Some("NO"), None),
        (CT, &["ORIGINAL", "PRIMARY"], Some("YES"), Some("say that text is drawn into their pixels")),
        (CT, &["ORIGINAL", "PRIMARY"], Some("PERHAPS"), Some("say that text is drawn into their pixels")),
        (uids::ENHANCED_MR_IMAGE_STORAGE, &["ORIGINAL", "PRIMARY"], None, None),
        (uids::RT_DOSE_STORAGE, &[], None, None),
        (uids::SECONDARY_CAPTURE_IMAGE_STORAGE, &["DERIVED", "PRIMARY"], None, Some("do not say whether")),
        (us, &["ORIGINAL", "PRIMARY"], None, Some("do not say whether")),
        (us, &["ORIGINAL", "PRIMARY"], Some("NO"), None),
        (uids::VIDEO_ENDOSCOPIC_IMAGE_STORAGE, &[], None, Some("do not say whether")),
        (uids::X_RAY_ANGIOGRAPHIC_IMAGE_STORAGE, &["ORIGINAL", "PRIMARY"], None, Some("do not say whether")),
        (uids::X_RAY_RADIOFLUOROSCOPIC_IMAGE_STORAGE, &[], None, Some("do not say whether")),
    ];
    for (class, image_type, burned_in, warned) in cases {
        let (object, notes) = copy_of(uids::EXPLICIT_VR_LITTLE_ENDIAN, |object| {
            object.put(element(tags::SOP_CLASS_UID, VR::UI, class));
            let words = image_type.iter().map(|word| (*word).to_owned()).collect();
            object.put(element(tags::IMAGE_TYPE, VR::CS, PrimitiveValue::Strs(words)));
            if let Some(word) = burned_in {
                object.put(element(tags::BURNED_IN_ANNOTATION, VR::CS, word));
            }
        })
        .unwrap();
        check_told(&object, &notes, warned);
    }
    let (object, notes) = copy_of(uids::EXPLICIT_VR_LITTLE_ENDIAN, |object| {
        object.put(element(tags::CONVERSION_TYPE, VR::CS, "WSD"));
    })
    .unwrap();
    check_told(&object, &notes, Some("do not say whether"));
    let (object, notes) = copy_of(uids::EXPLICIT_VR_LITTLE_ENDIAN, |object| {
        object.put(element(tags::RECOGNIZABLE_VISUAL_FEATURES, VR::CS, "YES"));
    })
    .unwrap();
    check_told(&object, &notes, Some("the patient can be recognized in their pixels"));
}

/// What is warned of, and only that, keeps a copy from saying that the patient is removed.
fn check_told(object: &DefaultDicomObject, notes: &[String], warned: Option<&str>) {
    assert_eq!(notes.len(), usize::from(warned.is_some()), "{notes:?}");
    assert!(
        warned.is_none_or(|words| notes[0].contains(words) && notes[0].starts_with("WARNING")),
        "{notes:?}"
    );
    let is_removed = object.element(tags::PATIENT_IDENTITY_REMOVED).unwrap().to_str().unwrap().into_owned();
    assert_eq!(is_removed == "YES", warned.is_none(), "{is_removed}");
    let has_profile = object.get(tags::DEIDENTIFICATION_METHOD_CODE_SEQUENCE).is_some();
    assert_eq!(has_profile, warned.is_none());
}
