//! Pictures of which a part would have to be guessed, and displays with a white subpixel.

use std::fs;
use std::path::Path;

use serde_json::{Value, json};
use tempfile::tempdir;

use crate::support::small_experiment;
use crate::{assert_refused, report, run};

/// A PNG file of 8 x 8 pixels of one colour (type 2 RGB, 4 gray with alpha, 6 RGB with alpha), with chunks
/// before the pixels.
fn png(colour: u8, pixel: &[u8], before: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let mut bytes = b"\x89PNG\r\n\x1a\n".to_vec();
    let mut chunk = |name: &[u8; 4], data: &[u8]| {
        bytes.extend((data.len() as u32).to_be_bytes());
        let named: Vec<u8> = name.iter().chain(data).copied().collect();
        bytes.extend(&named);
        bytes.extend(crc(&named).to_be_bytes());
    };
    chunk(b"IHDR", &[0, 0, 0, 8, 0, 0, 0, 8, 8, colour, 0, 0, 0]);
    for (name, data) in before {
        chunk(name, data);
    }
    let rows: Vec<u8> = (0..8).flat_map(|_| [0].into_iter().chain(pixel.repeat(8))).collect();
    // A zlib stream of one stored block.
    let length = rows.len() as u16;
    let mut stored = vec![0x78, 0x01, 0x01];
    stored.extend(length.to_le_bytes());
    stored.extend((!length).to_le_bytes());
    stored.extend(&rows);
    let (mut a, mut b) = (1_u32, 0_u32);
    for byte in &rows {
        a = (a + u32::from(*byte)) % 65_521;
        b = (b + a) % 65_521;
    }
    stored.extend((b << 16 | a).to_be_bytes());
    chunk(b"IDAT", &stored);
    chunk(b"IEND", &[]);
    bytes
}

/// CRC of PNG chunks.
fn crc(bytes: &[u8]) -> u32 {
    let step = |crc: u32, byte: &u8| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { c >> 1 ^ 0xEDB8_8320 } else { c >> 1 })
    };
    !bytes.iter().fold(u32::MAX, step)
}

fn of_picture(folder: &Path, picture: &[u8]) -> Value {
    fs::write(folder.join("picture.png"), picture).unwrap();
    let mut experiment = small_experiment(1);
    experiment["video"] = json!({"files": {"paths": ["picture.png"]}});
    experiment
}

/// Transparent pixels were laid over black, of an animation the first picture was taken, and orientation was ignored.
#[test]
fn pictures_that_would_be_guessed_are_refused() {
    let place = tempdir().unwrap();
    let refused = |picture: &[u8], words: &[&str]| {
        let output = run(place.path(), &of_picture(place.path(), picture));
        assert_refused(place.path(), &output, words);
    };
    refused(&png(4, &[200, 128], &[]), &["picture.png", "pixel [0, 0]", "alpha 0.502", "opaque"]);
    refused(&png(6, &[9, 9, 9, 0], &[]), &["picture.png", "alpha 0.000"]);
    refused(&png(2, &[9, 9, 9], &[(b"tRNS", &[0, 9, 0, 9, 0, 9])]), &["picture.png", "alpha 0.000"]);
    // Two pictures, played once; the first frame's place and time.
    let control = [0, 0, 0, 2, 0, 0, 0, 1];
    let frame = [0, 0, 0, 0, 0, 0, 0, 8, 0, 0, 0, 8, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 10, 0, 0];
    refused(&png(2, &[9, 9, 9], &[(b"acTL", &control), (b"fcTL", &frame)]), &["animation of 2 pictures"]);
    // A TIFF with one entry: orientation, short, 6.
    let turned = b"MM\0\x2a\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0\0\0\0\0";
    refused(&png(2, &[9, 9, 9], &[(b"eXIf", turned)]), &["EXIF orientation is 6", "allowed is 1"]);

    let opaque = report(place.path(), &of_picture(place.path(), &png(6, &[200, 200, 200, 255], &[])));
    assert!(opaque["frames"][0]["types"]["l"]["mean"].as_f64().unwrap() > 0.0);
}

/// A white subpixel is driven by the least of red, green and blue: pure red lights none of it. The mean of
/// the three was taken, silently.
#[test]
fn a_white_subpixel_needs_to_be_told_what_drives_it() {
    let place = tempdir().unwrap();
    let line = |name: &str, nm: f64| json!({"name": name, "spectrum": {"line": {"nm": nm, "fwhm_nm": 0}}});
    let rgbw = |with_white: bool, driven: Option<&str>| {
        let mut experiment = small_experiment(1);
        let mut primaries = vec![line("red", 620.0), line("green", 540.0), line("blue", 460.0)];
        if with_white {
            primaries.push(line("white", 560.0));
        }
        experiment["display"]["primaries"] = json!(primaries);
        experiment["counts"] = json!({"engine": "EXPECTED", "noise": "NONE"});
        experiment["video"] = json!({"pattern": {"uniform": {"rgb": [1, 0, 0]}}});
        if let Some(driven) = driven {
            experiment["display"]["white_driven_by"] = json!(driven);
        }
        experiment
    };
    let output = run(place.path(), &rgbw(true, None));
    assert_refused(place.path(), &output, &["display.white_driven_by", "MEAN", "LEAST"]);

    let l_over_m = |experiment: &Value| {
        let types = report(place.path(), experiment)["frames"][0]["types"].clone();
        types["l"]["mean"].as_f64().unwrap() / types["m"]["mean"].as_f64().unwrap()
    };
    let (red, least) = (l_over_m(&rgbw(false, None)), l_over_m(&rgbw(true, Some("LEAST"))));
    assert!((least / red - 1.0).abs() < 1e-3, "{least} {red}");
    assert!(l_over_m(&rgbw(true, Some("MEAN"))) < 0.5 * red);
}

/// Pictures that state another transfer than the display's are shown by the display's, with a warning in plan
/// and report.
#[test]
fn a_stated_transfer_that_is_not_the_displays_is_warned_of() {
    let place = tempdir().unwrap();
    let warned = |chunk: (&[u8; 4], &[u8])| -> String {
        let experiment = of_picture(place.path(), &png(2, &[99, 120, 140], &[chunk]));
        report(place.path(), &experiment)["warnings"].to_string()
    };
    // Primaries and transfer of BT.2100 PQ, then of sRGB.
    let pq = warned((b"cICP", &[9, 16, 0, 1]));
    assert!(
        ["video.clip.blobs[0]", "cICP 16", "PQ", "display.transfer SRGB"]
            .iter()
            .all(|word| pq.contains(word)),
        "{pq}"
    );
    assert_eq!(warned((b"cICP", &[1, 13, 0, 1])), "[]");
}
