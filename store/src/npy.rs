//! Arrays in NumPy's .npy format, version 1: a padded text header, then the values, little-endian, C order.

/// The type of the values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scalar {
    /// Counts.
    U32,
    /// Means.
    F32,
    /// Everything else.
    F64,
}

impl Scalar {
    fn name(self) -> &'static str {
        match self {
            Self::U32 => "<u4",
            Self::F32 => "<f4",
            Self::F64 => "<f8",
        }
    }
}

/// The header of an array; the values follow it, last index fastest.
pub fn header(scalar: Scalar, shape: &[usize]) -> Vec<u8> {
    const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
    let sizes: Vec<String> = shape.iter().map(ToString::to_string).collect();
    // A tuple of one has a comma behind it.
    let comma = if shape.len() == 1 { "," } else { "" };
    let mut text = format!(
        "{{'descr': '{}', 'fortran_order': False, 'shape': ({}{comma}), }}",
        scalar.name(),
        sizes.join(", ")
    );
    // Magic, two bytes of length, text and a newline together fill whole lines of 64 bytes.
    while !(MAGIC.len() + 2 + text.len() + 1).is_multiple_of(64) {
        text.push(' ');
    }
    text.push('\n');
    let mut bytes = MAGIC.to_vec();
    bytes.extend((text.len() as u16).to_le_bytes());
    bytes.extend(text.into_bytes());
    bytes
}

/// A whole array of u32.
pub fn u32_array(shape: &[usize], values: &[u32]) -> Vec<u8> {
    let mut bytes = header(Scalar::U32, shape);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// A whole array of f32.
pub fn f32_array(shape: &[usize], values: &[f32]) -> Vec<u8> {
    let mut bytes = header(Scalar::F32, shape);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

/// A whole array of f64.
pub fn f64_array(shape: &[usize], values: &[f64]) -> Vec<u8> {
    let mut bytes = header(Scalar::F64, shape);
    bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn header_is_aligned_and_says_the_shape() {
        for (shape, text) in
            [(&[2, 3][..], "(2, 3)"), (&[5][..], "(5,)"), (&[][..], "()"), (&[0, 7][..], "(0, 7)")]
        {
            let bytes = header(Scalar::F32, shape);
            assert_eq!(bytes.len() % 64, 0);
            let said = String::from_utf8_lossy(&bytes[10..]);
            assert!(said.contains(&format!("'shape': {text}")), "{said}");
            assert!(said.ends_with('\n'));
        }
        assert_eq!(u32_array(&[1, 2], &[1, 258])[64 * 2 - 64..].len() % 64, 8);
    }
}
