//! Reads numbers from JSON: the generated code asks here instead of the pbjson runtime.
//!
//! Numbers are JSON numbers; text is refused (so "NaN" is), except that 64-bit integers may be decimal text, because JSON
//! readers elsewhere round them above 2^53. A whole number may be written 3.0.

use std::fmt;
use std::marker::PhantomData;

use serde::de::{Deserialize, Deserializer, Error, Unexpected, Visitor};

/// A number read from JSON.
pub(crate) struct NumberDeserialize<T>(pub(crate) T);

/// The number types of the schema.
trait Number: Sized {
    /// What the error message says was expected.
    const EXPECTED: &'static str;
    /// Whether decimal text is taken.
    const TEXT: bool = false;
    fn from_u64(value: u64) -> Option<Self>;
    fn from_i64(value: i64) -> Option<Self>;
    fn from_f64(value: f64) -> Option<Self>;
}

impl Number for f64 {
    const EXPECTED: &'static str = "a number";
    fn from_u64(value: u64) -> Option<Self> {
        Some(value as Self)
    }
    fn from_i64(value: i64) -> Option<Self> {
        Some(value as Self)
    }
    fn from_f64(value: f64) -> Option<Self> {
        value.is_finite().then_some(value)
    }
}

/// 2^53: beyond it an f64 no longer tells neighbouring whole numbers apart.
const EXACT: f64 = 9_007_199_254_740_992.0;

/// The whole number that this is, exactly.
fn whole(value: f64) -> Option<i64> {
    (value.fract().abs() < f64::MIN_POSITIVE && value.abs() <= EXACT).then_some(value as i64)
}

macro_rules! integer {
    ($type:ty, $expected:literal, $text:literal) => {
        impl Number for $type {
            const EXPECTED: &'static str = $expected;
            const TEXT: bool = $text;
            fn from_u64(value: u64) -> Option<Self> {
                Self::try_from(value).ok()
            }
            fn from_i64(value: i64) -> Option<Self> {
                Self::try_from(value).ok()
            }
            fn from_f64(value: f64) -> Option<Self> {
                whole(value).and_then(|whole| Self::try_from(whole).ok())
            }
        }
    };
}

integer!(u32, "a whole number from 0 to 4294967295", false);
integer!(u64, "a whole number from 0 to 18446744073709551615", true);

impl<'de, T: Number> Deserialize<'de> for NumberDeserialize<T> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(NumberVisitor(PhantomData)).map(Self)
    }
}

struct NumberVisitor<T>(PhantomData<T>);

impl<T: Number> Visitor<'_> for NumberVisitor<T> {
    type Value = T;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(T::EXPECTED)
    }

    fn visit_u64<E: Error>(self, value: u64) -> Result<T, E> {
        T::from_u64(value).ok_or_else(|| E::invalid_value(Unexpected::Unsigned(value), &self))
    }

    fn visit_i64<E: Error>(self, value: i64) -> Result<T, E> {
        T::from_i64(value).ok_or_else(|| E::invalid_value(Unexpected::Signed(value), &self))
    }

    fn visit_f64<E: Error>(self, value: f64) -> Result<T, E> {
        T::from_f64(value).ok_or_else(|| E::invalid_value(Unexpected::Float(value), &self))
    }

    fn visit_str<E: Error>(self, text: &str) -> Result<T, E> {
        let wrong = || E::invalid_value(Unexpected::Str(text), &self);
        // `parse` takes a leading plus; the schema does not.
        if !T::TEXT || !text.bytes().all(|b| b.is_ascii_digit()) {
            return Err(wrong());
        }
        text.parse().ok().and_then(T::from_u64).ok_or_else(wrong)
    }
}
