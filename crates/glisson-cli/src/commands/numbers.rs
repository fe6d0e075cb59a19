//! Options of several numbers.

/// `N` finite numbers separated by commas.
pub(crate) fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let found: Vec<f64> = text
        .split(',')
        .map(|field| match field.trim().parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(format!("`{}` is not a finite number", field.trim())),
        })
        .collect::<Result<_, _>>()?;
    let n = found.len();
    found.try_into().map_err(|_| format!("{n} numbers, expected {N} separated by commas"))
}
