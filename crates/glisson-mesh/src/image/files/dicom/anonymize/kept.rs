//! What a copy without the patient keeps of a file: the attributes on one list, and of these only values that can say
//! nothing else than they should.

use std::path::Path;

use dicom_core::dictionary::{DataDictionary, DataDictionaryEntry, VirtualVr};
use dicom_core::header::HasLength;
use dicom_core::value::DataSetSequence;
use dicom_core::{DataElement, PrimitiveValue, VR};
use dicom_dictionary_std::tags;
use dicom_object::mem::InMemElement;
use dicom_object::{InMemDicomObject, Tag};

use super::super::super::error::{HeaderPlace, ImageError};
use super::super::frames::integer;
use super::identifiers::NewIdentifiers;

/// What is taken of an attribute.
#[derive(Clone, Copy, Debug)]
enum Rule {
    /// Numbers, or tags of attributes.
    Numbers,
    /// These words, others instead replaced by the first.
    Words(&'static [&'static str]),
    /// These words; the attribute is left out if there is another.
    WordsOrNone(&'static [&'static str]),
    /// Only these words: the file makes no sense with another.
    WordsOnly(&'static [&'static str]),
    /// An identifier of something of this patient: replaced.
    Identifier,
    /// The identifier of a class, which the standard defines.
    Class,
    /// The same; left out if it is another.
    ClassOrNone,
    /// Items, of which the same list is kept.
    Items,
}

const YES_NO: &[&str] = &["YES", "NO"];

/// Everything that is kept, at every level of a file.
const KEPT: &[(Tag, Rule)] = &[
    // Which file it is.
    (tags::SOP_CLASS_UID, Rule::Class),
    (tags::SOP_INSTANCE_UID, Rule::Identifier),
    (tags::STUDY_INSTANCE_UID, Rule::Identifier),
    (tags::SERIES_INSTANCE_UID, Rule::Identifier),
    (tags::FRAME_OF_REFERENCE_UID, Rule::Identifier),
    (tags::MODALITY, Rule::Words(MODALITIES)),
    (tags::IMAGE_TYPE, Rule::Words(IMAGE_TYPES)),
    (tags::FRAME_TYPE, Rule::Words(IMAGE_TYPES)),
    // Where the voxels are.
    (tags::ROWS, Rule::Numbers),
    (tags::COLUMNS, Rule::Numbers),
    (tags::NUMBER_OF_FRAMES, Rule::Numbers),
    (tags::IMAGE_POSITION_PATIENT, Rule::Numbers),
    (tags::IMAGE_ORIENTATION_PATIENT, Rule::Numbers),
    (tags::PIXEL_SPACING, Rule::Numbers),
    (tags::IMAGER_PIXEL_SPACING, Rule::Numbers),
    (tags::PIXEL_ASPECT_RATIO, Rule::Numbers),
    (tags::SLICE_THICKNESS, Rule::Numbers),
    (tags::SPACING_BETWEEN_SLICES, Rule::Numbers),
    (tags::SLICE_LOCATION, Rule::Numbers),
    (tags::GANTRY_DETECTOR_TILT, Rule::Numbers),
    (tags::GRID_FRAME_OFFSET_VECTOR, Rule::Numbers),
    (tags::FRAME_INCREMENT_POINTER, Rule::Numbers),
    (tags::PATIENT_POSITION, Rule::WordsOrNone(PATIENT_POSITIONS)),
    // What their numbers are.
    (tags::SAMPLES_PER_PIXEL, Rule::Numbers),
    (tags::PHOTOMETRIC_INTERPRETATION, Rule::WordsOnly(PHOTOMETRIC)),
    (tags::PLANAR_CONFIGURATION, Rule::Numbers),
    (tags::BITS_ALLOCATED, Rule::Numbers),
    (tags::BITS_STORED, Rule::Numbers),
    (tags::HIGH_BIT, Rule::Numbers),
    (tags::PIXEL_REPRESENTATION, Rule::Numbers),
    (tags::PIXEL_PADDING_VALUE, Rule::Numbers),
    (tags::PIXEL_PADDING_RANGE_LIMIT, Rule::Numbers),
    (tags::RESCALE_SLOPE, Rule::Numbers),
    (tags::RESCALE_INTERCEPT, Rule::Numbers),
    (tags::RESCALE_TYPE, Rule::Words(&["US", "HU", "OD", "HU_MOD", "MGML", "PCT"])),
    (tags::UNITS, Rule::WordsOrNone(PET_UNITS)),
    (tags::DOSE_GRID_SCALING, Rule::Numbers),
    (tags::DOSE_UNITS, Rule::WordsOrNone(&["GY", "RELATIVE"])),
    (tags::DOSE_TYPE, Rule::WordsOrNone(&["PHYSICAL", "EFFECTIVE", "ERROR"])),
    (tags::DOSE_SUMMATION_TYPE, Rule::WordsOrNone(DOSE_SUMMATIONS)),
    (tags::LOSSY_IMAGE_COMPRESSION, Rule::WordsOrNone(&["00", "01"])),
    (tags::LOSSY_IMAGE_COMPRESSION_RATIO, Rule::Numbers),
    (tags::LOSSY_IMAGE_COMPRESSION_METHOD, Rule::WordsOrNone(LOSSY_METHODS)),
    (tags::KVP, Rule::Numbers),
    // Which of several volumes at one place they are of.
    (tags::ACQUISITION_NUMBER, Rule::Numbers),
    (tags::TEMPORAL_POSITION_IDENTIFIER, Rule::Numbers),
    (tags::ECHO_NUMBERS, Rule::Numbers),
    // How they are shown.
    (tags::WINDOW_CENTER, Rule::Numbers),
    (tags::WINDOW_WIDTH, Rule::Numbers),
    (tags::VOILUT_FUNCTION, Rule::WordsOrNone(&["LINEAR", "LINEAR_EXACT", "SIGMOID"])),
    (tags::PRESENTATION_LUT_SHAPE, Rule::WordsOrNone(&["IDENTITY", "INVERSE"])),
    (tags::BURNED_IN_ANNOTATION, Rule::WordsOrNone(YES_NO)),
    (tags::RECOGNIZABLE_VISUAL_FEATURES, Rule::WordsOrNone(YES_NO)),
    // Files of many frames.
    (tags::SHARED_FUNCTIONAL_GROUPS_SEQUENCE, Rule::Items),
    (tags::PER_FRAME_FUNCTIONAL_GROUPS_SEQUENCE, Rule::Items),
    (tags::PLANE_POSITION_SEQUENCE, Rule::Items),
    (tags::PLANE_ORIENTATION_SEQUENCE, Rule::Items),
    (tags::PIXEL_MEASURES_SEQUENCE, Rule::Items),
    (tags::PIXEL_VALUE_TRANSFORMATION_SEQUENCE, Rule::Items),
    (tags::FRAME_VOILUT_SEQUENCE, Rule::Items),
    (tags::FRAME_CONTENT_SEQUENCE, Rule::Items),
    (tags::CT_IMAGE_FRAME_TYPE_SEQUENCE, Rule::Items),
    (tags::MR_IMAGE_FRAME_TYPE_SEQUENCE, Rule::Items),
    (tags::DIMENSION_INDEX_VALUES, Rule::Numbers),
    (tags::IN_STACK_POSITION_NUMBER, Rule::Numbers),
    (tags::TEMPORAL_POSITION_INDEX, Rule::Numbers),
    (
        tags::DIMENSION_ORGANIZATION_TYPE,
        Rule::WordsOrNone(&["3D", "3D_TEMPORAL", "TILED_FULL", "TILED_SPARSE"]),
    ),
    (tags::DIMENSION_ORGANIZATION_SEQUENCE, Rule::Items),
    (tags::DIMENSION_INDEX_SEQUENCE, Rule::Items),
    (tags::DIMENSION_ORGANIZATION_UID, Rule::Identifier),
    (tags::DIMENSION_INDEX_POINTER, Rule::Numbers),
    (tags::FUNCTIONAL_GROUP_POINTER, Rule::Numbers),
    // What other files it is of.
    (tags::DERIVATION_IMAGE_SEQUENCE, Rule::Items),
    (tags::SOURCE_IMAGE_SEQUENCE, Rule::Items),
    (tags::REFERENCED_IMAGE_SEQUENCE, Rule::Items),
    (tags::REFERENCED_SERIES_SEQUENCE, Rule::Items),
    (tags::REFERENCED_INSTANCE_SEQUENCE, Rule::Items),
    (tags::REFERENCED_SOP_CLASS_UID, Rule::ClassOrNone),
    (tags::REFERENCED_SOP_INSTANCE_UID, Rule::Identifier),
    (tags::REFERENCED_FRAME_NUMBER, Rule::Numbers),
    // Segmentations.
    (tags::SEGMENTATION_TYPE, Rule::WordsOnly(&["BINARY", "FRACTIONAL", "LABELMAP"])),
    (tags::SEGMENTATION_FRACTIONAL_TYPE, Rule::WordsOrNone(&["PROBABILITY", "OCCUPANCY"])),
    (tags::MAXIMUM_FRACTIONAL_VALUE, Rule::Numbers),
    (tags::SEGMENTS_OVERLAP, Rule::WordsOrNone(&["YES", "UNDEFINED", "NO"])),
    (tags::SEGMENT_SEQUENCE, Rule::Items),
    (tags::SEGMENT_NUMBER, Rule::Numbers),
    (tags::SEGMENT_ALGORITHM_TYPE, Rule::WordsOrNone(&["AUTOMATIC", "SEMIAUTOMATIC", "MANUAL"])),
    (tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE, Rule::Numbers),
    (tags::SEGMENT_IDENTIFICATION_SEQUENCE, Rule::Items),
    (tags::REFERENCED_SEGMENT_NUMBER, Rule::Numbers),
];

/// What made an image (DICOM PS3.3, C.7.3.1.1.1); `OT` is another.
const MODALITIES: &[&str] = &[
    "OT", "CT", "MR", "PT", "NM", "US", "XA", "RF", "CR", "DX", "MG", "SC", "SEG", "RTDOSE", "RTIMAGE",
    "OCT", "IVUS", "ES", "XC", "GM", "SM", "PX", "IO", "BMD", "OPT", "OP", "IVOCT", "TG", "LS", "EPS",
];

/// Values of ImageType and FrameType in images that make volumes (DICOM PS3.3, C.7.6.1.1.2, C.8.2.1.1.1, C.8.16.1).
const IMAGE_TYPES: &[&str] = &[
    "OTHER",
    "ORIGINAL",
    "DERIVED",
    "MIXED",
    "PRIMARY",
    "SECONDARY",
    "AXIAL",
    "LOCALIZER",
    "VOLUME",
    "REFORMATTED",
    "MPR",
    "RESAMPLED",
    "AVERAGE",
    "MAX_IP",
    "MIN_IP",
    "PROJECTION IMAGE",
    "SUBTRACTION",
    "ADDITION",
    "NONE",
    "HELICAL",
    "M",
    "P",
    "R",
    "I",
    "STATIC",
    "WHOLE BODY",
    "RECON TOMO",
];

/// How a patient lies (DICOM PS3.3, C.7.3.1.1.2).
const PATIENT_POSITIONS: &[&str] = &[
    "HFP", "HFS", "HFDR", "HFDL", "FFDR", "FFDL", "FFP", "FFS", "LFP", "LFS", "RFP", "RFS", "AFDR", "AFDL",
    "PFDR", "PFDL",
];

/// Pixels that mean what they say; palettes are tables of bytes, and no volume.
const PHOTOMETRIC: &[&str] = &[
    "MONOCHROME2",
    "MONOCHROME1",
    "RGB",
    "YBR_FULL",
    "YBR_FULL_422",
    "YBR_PARTIAL_422",
    "YBR_PARTIAL_420",
    "YBR_ICT",
    "YBR_RCT",
];

/// What values of PET are (DICOM PS3.3, C.8.9.1.1.3).
const PET_UNITS: &[&str] = &[
    "CNTS",
    "NONE",
    "CM2",
    "CM2ML",
    "PCNT",
    "CPS",
    "BQML",
    "MGMINML",
    "UMOLMINML",
    "MLMING",
    "MLG",
    "1CM",
    "UMOLML",
    "PROPCNTS",
    "PROPCPS",
    "MLMINML",
    "MLML",
    "GML",
    "STDDEV",
];

const DOSE_SUMMATIONS: &[&str] = &[
    "PLAN",
    "MULTI_PLAN",
    "PLAN_OVERVIEW",
    "FRACTION",
    "BEAM",
    "BRACHY",
    "FRACTION_SESSION",
    "BEAM_SESSION",
    "CONTROL_POINT",
];

const LOSSY_METHODS: &[&str] =
    &["ISO_10918_1", "ISO_14495_1", "ISO_15444_1", "ISO_15444_15", "ISO_13818_2", "ISO_14496_10"];

/// The beginning of the identifiers that the standard defines.
const OF_THE_STANDARD: &str = "1.2.840.10008.";

/// No volume has as many frames, stacks or times in one dimension.
const MAX_INDEX: u32 = 1 << 16;
/// Two spaces, the least number that two letters are.
const TWO_LETTERS: u16 = 0x2020;

/// A refusal that does not repeat what was found, which may be a name.
pub(super) fn refuse(file: &Path, tag: Tag, found: &str, allowed: &str) -> ImageError {
    ImageError::Header {
        file: file.to_path_buf(),
        field: dictionary_name(tag),
        place: HeaderPlace::Tag { group: tag.group(), element: tag.element() },
        found: found.into(),
        allowed: allowed.into(),
    }
}

fn dictionary_name(tag: Tag) -> String {
    let entry = dicom_dictionary_std::StandardDataDictionary.by_tag(tag);
    entry.map_or_else(|| "(unknown)".into(), |entry| entry.alias().to_owned())
}

/// What is kept of an object and of the items in it.
///
/// # Errors
/// An element that should be numbers, items, or a word that the standard defines, and is not; values that mean something
/// by a table.
pub(super) fn kept_of(
    file: &Path,
    object: &InMemDicomObject,
    identifiers: &NewIdentifiers,
) -> Result<InMemDicomObject, ImageError> {
    if object.get(tags::MODALITY_LUT_SEQUENCE).is_some() {
        let allowed = "a slope and an intercept: tables are not copied, and without theirs the values mean something else";
        return Err(refuse(file, tags::MODALITY_LUT_SEQUENCE, "a table of values", allowed));
    }
    let mut bare = InMemDicomObject::new_empty();
    for &(tag, rule) in KEPT {
        let Some(element) = object.get(tag) else { continue };
        if let Some(kept) = kept_element(file, element, rule, identifiers)? {
            bare.put(kept);
        }
    }
    if object.get(tags::SEGMENT_NUMBER).is_some() {
        let name = integer(object, tags::SEGMENT_NUMBER).map_or("Segment".into(), |n| format!("Segment {n}"));
        bare.put(DataElement::new(tags::SEGMENT_LABEL, VR::LO, PrimitiveValue::from(name)));
    }
    Ok(bare)
}

fn kept_element(
    file: &Path,
    element: &InMemElement,
    rule: Rule,
    identifiers: &NewIdentifiers,
) -> Result<Option<InMemElement>, ImageError> {
    let tag = element.header().tag;
    let as_word = |vr: VR, value: String| DataElement::new(tag, vr, PrimitiveValue::from(value));
    let words = || -> Vec<String> {
        let list = element.to_multi_str().map(|list| list.to_vec()).unwrap_or_default();
        list.iter().map(|word| word.trim_matches(['\0', ' ']).to_owned()).collect()
    };
    let replaced = |allowed: &[&str]| -> Vec<String> {
        let known = |word: &String| allowed.iter().find(|known| *known == word).unwrap_or(&allowed[0]);
        words().iter().map(|word| (*known(word)).to_owned()).collect()
    };
    let in_list = |list: Vec<String>| DataElement::new(tag, VR::CS, PrimitiveValue::Strs(list.into()));
    let are_all = |allowed: &[&str]| words().iter().all(|word| allowed.contains(&word.as_str()));
    Ok(match rule {
        Rule::Numbers => numbers(file, element)?,
        Rule::Words(allowed) => Some(in_list(replaced(allowed))),
        Rule::WordsOrNone(allowed) => are_all(allowed).then(|| in_list(words())),
        Rule::WordsOnly(allowed) if are_all(allowed) => Some(in_list(words())),
        Rule::WordsOnly(allowed) => {
            let allowed = format!("{} (other images are not copied)", allowed.join(", "));
            return Err(refuse(file, tag, "another word", &allowed));
        }
        Rule::Identifier => {
            let old = words().concat();
            (!old.is_empty()).then(|| as_word(VR::UI, identifiers.of(&old)))
        }
        Rule::Class => Some(as_word(VR::UI, class_of_the_standard(file, &words().concat())?)),
        Rule::ClassOrNone => {
            class_of_the_standard(file, &words().concat()).ok().map(|class| as_word(VR::UI, class))
        }
        Rule::Items => {
            // Programs that do not know a sequence write its bytes.
            let items = match element.items() {
                Some(items) => items,
                None if element.is_empty() => &[],
                None => {
                    return Err(refuse(
                        file,
                        tag,
                        "no sequence (of unknown kind, UN?)",
                        "items, as the standard says",
                    ));
                }
            };
            let bare: Result<Vec<_>, _> = items.iter().map(|item| kept_of(file, item, identifiers)).collect();
            Some(DataElement::new(tag, VR::SQ, DataSetSequence::from(bare?)))
        }
    })
}

/// The identifier of a class of objects, if the standard defines it.
///
/// # Errors
/// A class of a manufacturer's own, or none.
pub(super) fn class_of_the_standard(file: &Path, class: &str) -> Result<String, ImageError> {
    let class = class.trim_matches(['\0', ' ']);
    let is_of_the_standard = class.starts_with(OF_THE_STANDARD)
        && class.bytes().all(|byte| byte.is_ascii_digit() || byte == b'.')
        && class.len() <= 64;
    if is_of_the_standard {
        return Ok(class.to_owned());
    }
    let allowed = "a class of the standard: what is in objects of others nobody knows";
    Err(refuse(file, tags::SOP_CLASS_UID, "the class of a manufacturer, or none that can be read", allowed))
}

/// An element of numbers, as it is; none where it is empty.
fn numbers(file: &Path, element: &InMemElement) -> Result<Option<InMemElement>, ImageError> {
    let (tag, vr) = (element.header().tag, element.vr());
    let not_numbers = || refuse(file, tag, "no number", "numbers, as the standard says");
    let value = element.value().primitive().ok_or_else(not_numbers)?;
    let kept = match value {
        PrimitiveValue::Empty => return Ok(None),
        PrimitiveValue::Strs(_) | PrimitiveValue::Str(_) => {
            let list = element.to_multi_str().map_err(|_| not_numbers())?;
            let list: Vec<String> = list.iter().map(|one| one.trim_matches(['\0', ' ']).to_owned()).collect();
            if list.iter().all(String::is_empty) {
                return Ok(None);
            }
            let is_number = |one: &String| {
                // Rust's numbers can be words (`nan`); DICOM's cannot.
                one.bytes().all(|byte| b"0123456789+-.eE".contains(&byte)) && one.parse::<f64>().is_ok()
            };
            if ![VR::DS, VR::IS].contains(&vr) || !list.iter().all(is_number) {
                return Err(not_numbers());
            }
            PrimitiveValue::Strs(list.into())
        }
        binary if is_of_the_dictionary(tag, vr) && has_room_for_numbers_only(tag, binary) => value.clone(),
        _ => return Err(not_numbers()),
    };
    Ok(Some(DataElement::new(tag, vr, kept)))
}

/// Whether the standard gives an attribute a value representation.
fn is_of_the_dictionary(tag: Tag, vr: VR) -> bool {
    let entry = dicom_dictionary_std::StandardDataDictionary.by_tag(tag);
    entry.is_some_and(|entry| match entry.vr() {
        VirtualVr::Exact(known) => known == vr,
        VirtualVr::Xs => [VR::US, VR::SS].contains(&vr),
        _ => false,
    })
}

/// Whether a tag is that of an attribute of the standard, and not of a group's length or of a manufacturer.
fn is_of_an_attribute(tag: Tag) -> bool {
    let entry = dicom_dictionary_std::StandardDataDictionary.by_tag(tag);
    tag.group().is_multiple_of(2)
        && tag.element() != 0
        && entry.is_some_and(|entry| matches!(entry.vr(), VirtualVr::Exact(_)))
}

/// Whether binary numbers are as many as the attribute has, and such as it can have: where the length of an element is
/// damaged, it takes in the elements behind it, and their text becomes numbers.
fn has_room_for_numbers_only(tag: Tag, value: &PrimitiveValue) -> bool {
    match (tag, value) {
        (tags::FRAME_INCREMENT_POINTER, PrimitiveValue::Tags(list)) => {
            list.iter().all(|&tag| is_of_an_attribute(tag))
        }
        // Three letters or four are a larger number, and so are two of a shorter one.
        (tags::DIMENSION_INDEX_VALUES, PrimitiveValue::U32(list)) => list.iter().all(|&n| n < MAX_INDEX),
        (tags::REFERENCED_SEGMENT_NUMBER, PrimitiveValue::U16(list)) => list.iter().all(|&n| n < TWO_LETTERS),
        (tags::RECOMMENDED_DISPLAY_CIE_LAB_VALUE, PrimitiveValue::U16(list)) => list.len() <= 3,
        (
            _,
            PrimitiveValue::Tags(_)
            | PrimitiveValue::U16(_)
            | PrimitiveValue::I16(_)
            | PrimitiveValue::U32(_)
            | PrimitiveValue::I32(_)
            | PrimitiveValue::F32(_)
            | PrimitiveValue::F64(_),
        ) => value.multiplicity() == 1,
        _ => false,
    }
}
