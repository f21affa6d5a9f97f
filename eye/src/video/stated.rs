//! What a picture says of the meaning of its pixel values, held against the display's transfer, which
//! decides.

use crate::display::Transfer;

/// What a picture says of its pixel values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StatedTransfer {
    /// A transfer by its number (cICP chunk; ITU-T H.273, table 3).
    CodePoint(u8),
    /// An ICC profile (iCCP chunk), and whether it calls itself sRGB.
    Profile {
        /// Whether it calls itself sRGB.
        is_srgb: bool,
    },
}

impl StatedTransfer {
    /// What contradicts the display's transfer, in words; `None` where nothing does.
    pub fn against(self, transfer: Transfer) -> Option<String> {
        match self {
            Self::CodePoint(code) => {
                let near = |exponent: f64, other: f64| (exponent - other).abs() < 0.01;
                let (name, is_same) = match code {
                    1 | 6 | 14 | 15 => ("BT.709", transfer == Transfer::Bt1886),
                    4 => ("gamma 2.2", matches!(transfer, Transfer::Gamma(exponent) if near(exponent, 2.2))),
                    5 => ("gamma 2.8", matches!(transfer, Transfer::Gamma(exponent) if near(exponent, 2.8))),
                    8 => ("linear", transfer == Transfer::Linear),
                    13 => ("sRGB", transfer == Transfer::Srgb),
                    16 => ("PQ", transfer == Transfer::Pq),
                    18 => ("HLG", matches!(transfer, Transfer::Hlg(_))),
                    // Unspecified.
                    2 => return None,
                    _ => ("another one", false),
                };
                (!is_same).then(|| format!("it states the transfer {name} (cICP {code})"))
            }
            Self::Profile { is_srgb: true } if transfer == Transfer::Srgb => None,
            Self::Profile { .. } => Some("its ICC profile is not read".to_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn transfers_are_held_against_what_is_stated() {
        for (code, transfer) in [
            (1, Transfer::Bt1886),
            (4, Transfer::Gamma(2.2)),
            (8, Transfer::Linear),
            (13, Transfer::Srgb),
            (16, Transfer::Pq),
            (18, Transfer::Hlg(None)),
        ] {
            assert_eq!(StatedTransfer::CodePoint(code).against(transfer), None);
            assert!(StatedTransfer::CodePoint(code).against(Transfer::Gamma(3.0)).is_some());
            assert_eq!(StatedTransfer::CodePoint(2).against(transfer), None);
        }
        assert_eq!(StatedTransfer::Profile { is_srgb: true }.against(Transfer::Srgb), None);
        assert!(StatedTransfer::Profile { is_srgb: true }.against(Transfer::Pq).is_some());
        assert!(StatedTransfer::Profile { is_srgb: false }.against(Transfer::Srgb).is_some());
    }
}
