//! Content digests: BLAKE3-256 over a typed canonical encoding.
//!
//! The encoding is postcard's: positional fields, f64 as bits, strings and sequences with their length first, options and enums
//! with a tag. Domain-separated by a kind and a version. Never over JSON or protobuf bytes: those give different inputs the same
//! text or the same input different bytes. Validation folds -0 into 0 and refuses NaN and infinities before a value gets here.

use std::fmt;

use serde::{Deserialize, Serialize};

/// A 256-bit digest, written as 64 hex digits.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest(pub [u8; 32]);

impl fmt::Display for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
    }
}

impl fmt::Debug for Digest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl std::str::FromStr for Digest {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is not a digest of 64 hex digits");
        if text.len() != 64 || !text.is_ascii() {
            return Err(wrong());
        }
        let mut bytes = [0; 32];
        for (byte, i) in bytes.iter_mut().zip((0..64).step_by(2)) {
            *byte = u8::from_str_radix(&text[i..i + 2], 16).map_err(|_| wrong())?;
        }
        Ok(Self(bytes))
    }
}

impl Serialize for Digest {
    fn serialize<S: serde::Serializer>(&self, s: S) -> Result<S::Ok, S::Error> {
        s.collect_str(self)
    }
}

impl<'de> Deserialize<'de> for Digest {
    fn deserialize<D: serde::Deserializer<'de>>(d: D) -> Result<Self, D::Error> {
        String::deserialize(d)?.parse().map_err(serde::de::Error::custom)
    }
}

/// The digest of a value of the given kind and version.
///
/// # Errors
/// When the value cannot be encoded (a sequence of unknown length); the model's own types always can.
pub fn digest_of<T: Serialize + ?Sized>(
    kind: &str,
    version: u32,
    value: &T,
) -> Result<Digest, postcard::Error> {
    let bytes = postcard::to_stdvec(&("photoneye", kind, version, value))?;
    Ok(Digest(*blake3::hash(&bytes).as_bytes()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distinguishes_what_json_would_not() {
        let digest = |seed: u64| digest_of("test", 1, &seed).unwrap();
        assert_ne!(digest(1 << 53), digest((1 << 53) + 1));
        assert_ne!(digest_of("a", 1, &1_u8).unwrap(), digest_of("b", 1, &1_u8).unwrap());
        assert_ne!(digest_of("a", 1, &1_u8).unwrap(), digest_of("a", 2, &1_u8).unwrap());
        assert_ne!(digest_of("a", 1, &("ab", "c")).unwrap(), digest_of("a", 1, &("a", "bc")).unwrap());
    }

    #[test]
    fn text_round_trips() {
        let digest = digest_of("test", 1, "text").unwrap();
        assert_eq!(digest.to_string().parse::<Digest>().unwrap(), digest);
        assert!("zz".parse::<Digest>().is_err());
    }
}
