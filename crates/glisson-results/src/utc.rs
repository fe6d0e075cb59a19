//! Dates as texts (RFC 3339, UTC, milliseconds), so that their order is that of the texts.

const MS_PER_DAY: i64 = 86_400_000;

/// A time as text: `2026-03-09T14:05:07.250Z`. `unix_ms` counts from 1970-01-01T00:00:00Z without leap seconds, as clocks of
/// computers do.
///
/// # Panics
/// Outside the years 0 to 9999, for which RFC 3339 has no text.
///
/// ```
/// assert_eq!(glisson_results::utc::utc_text(1_000_000_000_000), "2001-09-09T01:46:40.000Z");
/// ```
pub fn utc_text(unix_ms: i64) -> String {
    let (day, ms) = (unix_ms.div_euclid(MS_PER_DAY), unix_ms.rem_euclid(MS_PER_DAY));
    let (year, month, day) = date_of(day);
    assert!((0..=9999).contains(&year), "the year {year} has no RFC 3339 text");
    let (second, ms) = (ms / 1000, ms % 1000);
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{ms:03}Z")
}

/// Whether a text is a time as [`utc_text`] writes it.
pub fn is_utc_text(text: &str) -> bool {
    let pattern = "dddd-dd-ddTdd:dd:dd.dddZ";
    let fits = |(found, wanted): (char, char)| {
        if wanted == 'd' { found.is_ascii_digit() } else { found == wanted }
    };
    let within = |range: std::ops::Range<usize>, allowed: std::ops::RangeInclusive<u32>| {
        text[range].parse().is_ok_and(|number| allowed.contains(&number))
    };
    text.len() == pattern.len()
        && text.chars().zip(pattern.chars()).all(fits)
        && within(5..7, 1..=12)
        && within(8..10, 1..=31)
        && within(11..13, 0..=23)
        && within(14..16, 0..=59)
        && within(17..19, 0..=60)
}

/// Year, month and day of a day that is counted from 1970-01-01, in the Gregorian calendar. It repeats after 400 years, which
/// have 146,097 days; years are counted from March here, so that the leap day is a year's last.
fn date_of(day: i64) -> (i64, i64, i64) {
    // From 0000-03-01.
    let day = day + 719_468;
    let (era, day) = (day.div_euclid(146_097), day.rem_euclid(146_097));
    let year = (day - day / 1460 + day / 36_524 - day / 146_096) / 365;
    let day = day - (365 * year + year / 4 - year / 100);
    let month = (5 * day + 2) / 153;
    let day_of_month = day - (153 * month + 2) / 5 + 1;
    let month = if month < 10 { month + 3 } else { month - 9 };
    (400 * era + year + i64::from(month <= 2), month, day_of_month)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_times_have_their_texts() {
        // `date -u -d @SECONDS` of GNU coreutils.
        for (unix_s, expected) in [
            (0, "1970-01-01T00:00:00.000Z"),
            (-1, "1969-12-31T23:59:59.000Z"),
            (951_782_400, "2000-02-29T00:00:00.000Z"),
            (951_868_800, "2000-03-01T00:00:00.000Z"),
            (1_709_251_199, "2024-02-29T23:59:59.000Z"),
            (4_107_542_400, "2100-03-01T00:00:00.000Z"),
            (253_402_300_799, "9999-12-31T23:59:59.000Z"),
        ] {
            assert_eq!(utc_text(1000 * unix_s), expected);
        }
        assert_eq!(utc_text(1_709_251_199_042), "2024-02-29T23:59:59.042Z");
    }

    #[test]
    fn every_day_follows_the_day_before() {
        let days = (-200_000..200_000).map(date_of).collect::<Vec<_>>();
        for pair in days.windows(2) {
            let ((y0, m0, d0), (y1, m1, d1)) = (pair[0], pair[1]);
            let is_next = match (m1, d1) {
                (1, 1) => (m0, d0, y1) == (12, 31, y0 + 1),
                (_, 1) => (m1, y1) == (m0 + 1, y0) && (28..=31).contains(&d0),
                _ => (y1, m1, d1) == (y0, m0, d0 + 1),
            };
            assert!(is_next, "{:?} follows {:?}", pair[1], pair[0]);
        }
    }

    #[test]
    fn only_its_own_texts_are_times() {
        assert!(is_utc_text(&utc_text(1_709_251_199_042)));
        for wrong in [
            "",
            "2024-02-29",
            "2024-02-29T23:59:59Z",
            "2024-02-29T23:59:59.042+01:00",
            "2024-13-29T23:59:59.042Z",
            "2024-02-29T24:59:59.042Z",
            "2024-02-2äT23:59:59.04Z",
        ] {
            assert!(!is_utc_text(wrong), "{wrong}");
        }
    }
}
