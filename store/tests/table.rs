//! Tables come back as they were written, and damage is an error.

use std::io::Cursor;

use arrow_array::cast::AsArray;
use arrow_array::types::{UInt32Type, UInt64Type};
use arrow_ipc::reader::StreamReader;
use photoneye_store::photons::{Photons, photons_stream, read_photons};
use photoneye_store::table::{
    Chunk, ConeColumns, Counts, CountsTable, CountsVec, cones_file, counts_stream, read_cones_file,
    read_counts, read_counts_le,
};
use proptest::prelude::*;

fn cones() -> ConeColumns {
    ConeColumns {
        id: vec![5, u64::MAX],
        x_um: vec![1.0, -2.5],
        y_um: vec![0.0, 3.0],
        x_deg: vec![0.1, 0.2],
        y_deg: vec![0.3, 0.4],
        ecc_deg: vec![0.5, 0.6],
        meridian_deg: vec![0.0, 359.0],
        kind: vec![0, 2],
        aperture_um2: vec![4.5, 3.5],
        edge: vec![false, true],
        polygon_start: vec![0, 6, 14],
        polygon: (0..14).map(|i| i as f32).collect(),
    }
}

#[test]
fn cones_come_back() {
    let cones = cones();
    assert_eq!(read_cones_file(&cones_file(&cones).unwrap()).unwrap(), cones);
    assert_eq!(cones.polygon_of(0).len(), 6);
    assert_eq!(cones.polygon_of(9).len(), 0);
    let mut twice = cones.clone();
    twice.append(&cones);
    assert_eq!(twice.polygon_of(3), cones.polygon_of(1));
    assert_eq!(read_cones_file(&cones_file(&twice).unwrap()).unwrap(), twice);
    let none = ConeColumns::default();
    assert_eq!(read_cones_file(&cones_file(&none).unwrap()).unwrap().len(), 0);
    let mut uneven = cones;
    uneven.x_um.pop();
    assert!(cones_file(&uneven).is_err());
}

#[test]
fn counts_come_back() {
    for counts in [Counts::U32(&[0, 1, u32::MAX]), Counts::F32(&[0.5, 1e-12]), Counts::U32(&[])] {
        let bytes = counts_stream(3, 4, 1 << 40, counts).unwrap();
        let chunk = read_counts(&bytes).unwrap();
        let plain: Vec<u8> = match &chunk.counts {
            CountsVec::U32(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
            CountsVec::F32(values) => values.iter().flat_map(|value| value.to_le_bytes()).collect(),
        };
        assert_eq!(read_counts_le(&bytes).unwrap().as_slice(), plain);
        assert_eq!((chunk.frame, chunk.tile, chunk.first_cone), (3, 4, 1 << 40));
        match (counts, chunk.counts) {
            (Counts::U32(a), CountsVec::U32(b)) => assert_eq!(a, b),
            (Counts::F32(a), CountsVec::F32(b)) => assert_eq!(a, b),
            _ => panic!("another type came back"),
        }
    }
}

#[test]
fn same_counts_same_bytes() {
    let values: Vec<u32> = (0..10_000).map(|i| i * 7919 % 800).collect();
    let bytes = counts_stream(1, 2, 3, Counts::U32(&values)).unwrap();
    assert!((0..10).all(|_| counts_stream(1, 2, 3, Counts::U32(&values)).unwrap() == bytes));
}

#[test]
fn many_chunks_are_one_stream() {
    let mut table = CountsTable::new(false).unwrap();
    let mut bytes = Vec::new();
    for frame in 0..3 {
        let counts = CountsVec::U32(vec![frame, 7]);
        bytes.extend(table.push(&Chunk { frame, tile: 0, first_cone: 10, counts }, 0).unwrap());
    }
    bytes.extend(table.finish().unwrap());
    let batches: Vec<_> = StreamReader::try_new(Cursor::new(bytes), None).unwrap().collect();
    assert_eq!(batches.len(), 3);
    let last = batches[2].as_ref().unwrap();
    assert_eq!(last.column_by_name("cone").unwrap().as_primitive::<UInt64Type>().values(), &[10, 11]);
    assert_eq!(last.column_by_name("count").unwrap().as_primitive::<UInt32Type>().values(), &[2, 7]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 2000, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whatever is damaged, reading ends with a table or an error. Lengths inside compressed buffers are left alone: a
    /// wild one would ask for that much memory, and blobs are verified before they are parsed.
    #[test]
    fn damage_never_panics(at in 0.0..1.0_f64, bit in 0_u32..8, cut in 0.0..1.0_f64, truncate: bool) {
        let mut bytes = cones_file(&cones()).unwrap();
        if truncate {
            bytes.truncate((cut * bytes.len() as f64) as usize);
        } else {
            let at = (at * bytes.len() as f64) as usize;
            bytes[at] ^= 1 << bit;
        }
        let _ = read_cones_file(&bytes);
    }
}

#[test]
fn photons_come_back_from_behind_the_counts() {
    let counts = counts_stream(0, 0, 0, Counts::U32(&[1, 0, 1])).unwrap();
    assert_eq!(read_photons(&counts).unwrap(), None);
    for photons in [
        Photons::default(),
        Photons { time_s: vec![0.25, 0.5], wavelength_nm: vec![543.0, 632.5], cone: vec![1 << 40, 7] },
    ] {
        let chunk = [counts.clone(), photons_stream(&photons).unwrap()].concat();
        assert_eq!(read_counts(&chunk).unwrap().counts, CountsVec::U32(vec![1, 0, 1]));
        assert_eq!(read_photons(&chunk).unwrap(), Some(photons));
        for end in counts.len() + 1..chunk.len() - 8 {
            assert!(read_photons(&chunk[..end]).is_err(), "{end}");
        }
    }
}

#[test]
fn truncated_counts_are_an_error() {
    let bytes = counts_stream(0, 0, 0, Counts::U32(&[1, 2, 3])).unwrap();
    for end in 0..bytes.len() - 8 {
        assert!(read_counts(&bytes[..end]).is_err(), "{end}");
    }
}
