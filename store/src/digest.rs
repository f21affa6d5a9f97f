//! The name of a blob: BLAKE3-256 of its bytes and their number, written `b3:<64 hex digits>/<size>`.

use std::fmt;
use std::str::FromStr;

/// A blob's hash and size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct BlobDigest {
    /// BLAKE3-256 of the bytes.
    pub hash: [u8; 32],
    /// Number of bytes.
    pub size: u64,
}

impl BlobDigest {
    /// The digest of these bytes.
    pub fn of(bytes: &[u8]) -> Self {
        Self { hash: blake3::hash(bytes).into(), size: bytes.len() as u64 }
    }

    /// The hash as 64 hex digits.
    pub fn hex(&self) -> String {
        blake3::Hash::from_bytes(self.hash).to_hex().to_string()
    }
}

impl fmt::Display for BlobDigest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "b3:{}/{}", self.hex(), self.size)
    }
}

/// The text is not a blob digest.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a digest of the form b3:<64 hex digits>/<size>")]
pub struct NotADigest(String);

impl FromStr for BlobDigest {
    type Err = NotADigest;

    fn from_str(text: &str) -> Result<Self, NotADigest> {
        parse(text).ok_or_else(|| NotADigest(text.chars().take(100).collect()))
    }
}

/// One text for one digest: lower-case hex, no leading zeros in the size.
fn parse(text: &str) -> Option<BlobDigest> {
    let (hex, size_text) = text.strip_prefix("b3:")?.split_once('/')?;
    let size: u64 = size_text.parse().ok()?;
    let digest = BlobDigest { hash: *blake3::Hash::from_hex(hex).ok()?.as_bytes(), size };
    (digest.to_string() == text).then_some(digest)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_and_back() {
        let digest = BlobDigest::of(b"");
        let text = digest.to_string();
        assert_eq!(text, "b3:af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262/0");
        assert_eq!(text.parse(), Ok(digest));
        for wrong in [
            "",
            "b3:",
            "b3:00/1",
            &text.to_uppercase(),
            &format!("{text}0"),
            &text[3..],
            &text.replace("/0", "/+0"),
        ] {
            assert!(wrong.parse::<BlobDigest>().is_err(), "{wrong}");
        }
    }
}
