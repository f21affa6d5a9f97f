//! Bytes of numeric artifacts: a JSON head with its length, then little-endian f64 numbers. Lengths are checked before anything
//! is allocated.

use serde::{Serialize, de::DeserializeOwned};

/// Head and numbers as bytes.
///
/// # Errors
/// When the head cannot be written as JSON.
pub fn encode<T: Serialize>(
    magic: [u8; 8],
    head: &T,
    numbers: impl Iterator<Item = f64>,
) -> Result<Vec<u8>, String> {
    let head = serde_json::to_vec(head).map_err(|e| e.to_string())?;
    let mut bytes = magic.to_vec();
    bytes.extend((head.len() as u64).to_le_bytes());
    bytes.extend(head);
    for number in numbers {
        bytes.extend(number.to_le_bytes());
    }
    Ok(bytes)
}

/// The head and the numbers.
///
/// # Errors
/// When the bytes do not begin with the magic or are cut.
pub fn decode<T: DeserializeOwned>(magic: [u8; 8], bytes: &[u8]) -> Result<(T, Vec<f64>), String> {
    let rest = bytes.strip_prefix(&magic).ok_or("not this kind of artifact")?;
    let (length, rest) = rest.split_first_chunk::<8>().ok_or("cut in its head")?;
    let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|e| e.to_string())?;
    if length > rest.len() {
        return Err("cut in its head".into());
    }
    let (head, body) = rest.split_at(length);
    if body.len() % 8 != 0 {
        return Err("cut in its numbers".into());
    }
    let head = serde_json::from_slice(head).map_err(|e| e.to_string())?;
    let (words, _) = body.as_chunks::<8>();
    Ok((head, words.iter().map(|b| f64::from_le_bytes(*b)).collect()))
}
