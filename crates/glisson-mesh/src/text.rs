//! Words in messages: what the user probably meant.

/// The name in `allowed` that `found` probably stands for, if one is close enough to be worth saying.
pub fn closest_name<'a>(found: &str, allowed: &[&'a str]) -> Option<&'a str> {
    let wanted = found.to_lowercase();
    allowed
        .iter()
        .map(|name| (strsim::damerau_levenshtein(&wanted, &name.to_lowercase()), *name))
        .filter(|(distance, name)| *distance <= 1.max(name.len() / 3))
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, name)| name)
}

/// `; did you mean "name"?` or nothing: the tail of a message about an unknown name.
pub fn did_you_mean(found: &str, allowed: &[&str]) -> String {
    closest_name(found, allowed).map(|name| format!("; did you mean \"{name}\"?")).unwrap_or_default()
}

/// A text as an attribute of XML takes it.
pub fn escaped_xml(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_typing_mistake_finds_its_name_and_nonsense_finds_none() {
        let allowed = ["young_modulus", "poisson_ratio", "density"];
        assert_eq!(closest_name("yuong_modulus", &allowed), Some("young_modulus"));
        assert_eq!(closest_name("Poisson_Ratio", &allowed), Some("poisson_ratio"));
        assert_eq!(closest_name("colour", &allowed), None);
        assert_eq!(did_you_mean("densty", &allowed), "; did you mean \"density\"?");
    }
}
