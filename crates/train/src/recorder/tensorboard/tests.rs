//! The event files, read back by a reader that shares nothing with the crate that writes them: records (TFRecord) and the
//! protocol-buffer fields of TensorFlow's `event.proto` and `summary.proto`. `tests/readers/tensorboard_events.py` does the
//! same with TensorBoard's own reader.

use super::*;
use std::collections::BTreeMap;

/// CRC-32C bit by bit, masked as TFRecord masks it.
fn masked_crc(bytes: &[u8]) -> u32 {
    let crc = bytes.iter().fold(u32::MAX, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |crc, _| (crc >> 1) ^ (if crc & 1 == 1 { 0x82F6_3B78 } else { 0 }))
    });
    (!crc).rotate_right(15).wrapping_add(0xA282_EAD8)
}

/// The payloads of a file; every length and payload must carry its checksum.
fn records(mut bytes: &[u8]) -> Vec<Vec<u8>> {
    let mut found = Vec::new();
    while !bytes.is_empty() {
        let (head, rest) = bytes.split_at(12);
        let length = u64::from_le_bytes(head[..8].try_into().unwrap()) as usize;
        assert_eq!(u32::from_le_bytes(head[8..].try_into().unwrap()), masked_crc(&head[..8]));
        let (payload, rest) = rest.split_at(length);
        assert_eq!(u32::from_le_bytes(rest[..4].try_into().unwrap()), masked_crc(payload));
        found.push(payload.to_vec());
        bytes = &rest[4..];
    }
    found
}

/// A field of a message.
#[derive(Clone, Debug)]
enum Field {
    Number(u64),
    Bytes(Vec<u8>),
}

impl Field {
    fn bytes(&self) -> &[u8] {
        match self {
            Self::Bytes(bytes) => bytes,
            Self::Number(number) => panic!("{number} is not bytes"),
        }
    }

    fn number(&self) -> u64 {
        match self {
            Self::Number(number) => *number,
            Self::Bytes(bytes) => panic!("{bytes:?} is no number"),
        }
    }

    fn double(&self) -> f64 {
        f64::from_bits(self.number())
    }

    /// A packed list of doubles.
    fn doubles(&self) -> Vec<f64> {
        self.bytes().chunks(8).map(|chunk| f64::from_le_bytes(chunk.try_into().unwrap())).collect()
    }
}

/// The fields of a message by number; of repeated ones the last.
fn message(mut bytes: &[u8]) -> BTreeMap<u64, Field> {
    fn varint(bytes: &mut &[u8]) -> u64 {
        let mut value = 0;
        for shift in (0..).step_by(7) {
            let byte = bytes[0];
            *bytes = &bytes[1..];
            value |= u64::from(byte & 127) << shift;
            if byte < 128 {
                break;
            }
        }
        value
    }
    fn take<'a>(bytes: &mut &'a [u8], count: usize) -> &'a [u8] {
        let (taken, rest) = bytes.split_at(count);
        *bytes = rest;
        taken
    }
    let mut fields = BTreeMap::new();
    while !bytes.is_empty() {
        let key = varint(&mut bytes);
        let field = match key & 7 {
            0 => Field::Number(varint(&mut bytes)),
            1 => Field::Number(u64::from_le_bytes(take(&mut bytes, 8).try_into().unwrap())),
            2 => {
                let length = varint(&mut bytes) as usize;
                Field::Bytes(take(&mut bytes, length).to_vec())
            }
            5 => Field::Number(u64::from(u32::from_le_bytes(take(&mut bytes, 4).try_into().unwrap()))),
            kind => panic!("wire type {kind}"),
        };
        fields.insert(key >> 3, field);
    }
    fields
}

/// The values of a file's events as (tag, step, fields of the value).
fn values(folder: &Path) -> Vec<(String, u64, BTreeMap<u64, Field>)> {
    let file = std::fs::read_dir(folder).unwrap().next().unwrap().unwrap().path();
    let events: Vec<_> = records(&std::fs::read(file).unwrap()).iter().map(|record| message(record)).collect();
    assert_eq!(events[0][&3].bytes(), b"brain.Event:2");
    let value = |event: &BTreeMap<u64, Field>| {
        let value = message(message(event[&5].bytes())[&1].bytes());
        (String::from_utf8(value[&1].bytes().to_vec()).unwrap(), event.get(&2).map_or(0, Field::number), value)
    };
    events[1..].iter().map(value).collect()
}

#[test]
fn scalars_pictures_and_histograms_come_back() {
    let home = tempfile::tempdir().unwrap();
    let mut board = TensorBoard::new(home.path());
    let row = [("loss".to_string(), 0.25), ("matching".to_string(), -1e-3)];
    board.row(&Row { stage: "adjacent", step: 3, kind: Kind::Train, values: &row }).unwrap();
    board.row(&Row { stage: "adjacent", step: 300, kind: Kind::Validate, values: &row[..1] }).unwrap();
    let picture = RgbImage::from_fn(5, 2, |x, y| image::Rgb([x as u8, y as u8, 8]));
    board.picture("svbrdf", 4, "maps0", &picture).unwrap();
    let spread = Histogram::of(&[-1.0, 0.0, 0.0, 3.0]).unwrap();
    board.histogram("svbrdf", 5, Quantity::Gradients, "head.weight", &spread).unwrap();
    drop(board);

    let found = values(home.path());
    let tags: Vec<_> = found.iter().map(|(tag, step, _)| (tag.as_str(), *step)).collect();
    let expected = [
        ("adjacent/loss", 3),
        ("adjacent/matching", 3),
        ("adjacent-held-out/loss", 300),
        ("svbrdf/maps0", 4),
        ("svbrdf-gradients/head.weight", 5),
    ];
    assert_eq!(tags, expected);
    let scalar = |i: usize| f32::from_bits(found[i].2[&2].number() as u32);
    assert_eq!([scalar(0), scalar(1), scalar(2)], [0.25, -1e-3, 0.25]);
    let image = message(found[3].2[&4].bytes());
    assert_eq!(image::load_from_memory(image[&4].bytes()).unwrap().to_rgb8(), picture);
    let histogram = message(found[4].2[&5].bytes());
    let [least, largest, number, sum, squares] = [1, 2, 3, 4, 5].map(|field| histogram[&field].double());
    assert_eq!([least, largest, number, sum, squares], [-1.0, 3.0, 4.0, 2.0, 10.0]);
    let (ends, counts) = (histogram[&6].doubles(), histogram[&7].doubles());
    assert_eq!((ends.len(), counts.len(), counts.iter().sum::<f64>()), (48, 48, 4.0));
    assert_eq!((ends[47], counts[0], counts[12], counts[47]), (3.0, 1.0, 2.0, 1.0));
}

#[test]
fn a_folder_that_cannot_be_written_stops_no_run() {
    let home = tempfile::tempdir().unwrap();
    let file = home.path().join("file");
    std::fs::write(&file, "").unwrap();
    let mut board = TensorBoard::new(&file.join("tb"));
    board.row(&Row { stage: "a", step: 1, kind: Kind::Train, values: &[("loss".into(), 1.0)] }).unwrap();
    board.flush().unwrap();
}
