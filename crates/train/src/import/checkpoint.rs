//! Tensors of a checkpoint: what `torch.save` has written since 2017, or safetensors.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs::{self, File},
    io::Read,
    ops::Range,
    path::{Path, PathBuf},
};

use half::{bf16, f16};
use ops::weights::{StoredTensor, Tensors, WeightsError, read_tensors};

use super::pickle::{Object, Pickle, PickleError, Storage, View};

/// Largest checkpoint that is read; the published net has 37 MB.
const LARGEST: u64 = 4 << 30;
/// Entries under which checkpoints of training programs keep the weights.
const STATE_DICTS: [&str; 3] = ["state_dict", "model_state_dict", "model"];
/// What the oldest of the two containers of `torch.save` begins with: the magic number's pickle.
const LEGACY: &[u8] = b"\x80\x02\x8a\x0al\xfc\x9cF\xf9 j\xa8P\x19.";
/// What an archive begins with.
const ARCHIVE: &[u8] = b"PK\x03\x04";

/// A checkpoint that can't be read.
#[derive(Debug, thiserror::Error)]
pub enum CheckpointError {
    /// The system refuses.
    #[error("{} can't be read: {source}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Neither container.
    #[error(
        "{} is not a checkpoint: expected what `torch.save(net.state_dict(), FILE)` writes (.pth, .pt, .pth.tar) or safetensors",
        path.display()
    )]
    Unknown {
        /// The file.
        path: PathBuf,
    },
    /// A checkpoint cut short, damaged, or beyond what is read.
    #[error("{} can't be read as a PyTorch checkpoint: {reason}; copy it again, or save it anew with `torch.save(net.state_dict(), FILE)`", path.display())]
    Broken {
        /// The file.
        path: PathBuf,
        /// What the reader met.
        reason: String,
    },
    /// Safetensors that can't be read.
    #[error(transparent)]
    Safetensors(#[from] WeightsError),
}

/// What the readers of the two containers meet.
#[derive(Debug, thiserror::Error)]
enum Reason {
    #[error(transparent)]
    Pickle(#[from] PickleError),
    #[error("{0}")]
    Other(String),
}

fn other<T>(reason: impl Into<String>) -> Result<T, Reason> {
    Err(Reason::Other(reason.into()))
}

/// The tensors of a checkpoint by name.
///
/// # Errors
/// See [`CheckpointError`].
pub fn read(path: &Path) -> Result<Tensors, CheckpointError> {
    let refused = |source| CheckpointError::Read { path: path.into(), source };
    let size = fs::metadata(path).map_err(refused)?.len();
    let mut start = Vec::new();
    File::open(path).and_then(|file| file.take(16).read_to_end(&mut start)).map_err(refused)?;
    if start.get(8) == Some(&b'{') {
        return Ok(read_tensors(path)?);
    }
    if size > LARGEST {
        let reason = format!("it has {} MiB, expected at most {}", size >> 20, LARGEST >> 20);
        return Err(CheckpointError::Broken { path: path.into(), reason });
    }
    match decode(&fs::read(path).map_err(refused)?) {
        Some(Ok(tensors)) => Ok(tensors),
        Some(Err(reason)) => Err(CheckpointError::Broken { path: path.into(), reason: reason.to_string() }),
        None => Err(CheckpointError::Unknown { path: path.into() }),
    }
}

/// The tensors of a checkpoint's bytes; `None` when they are none of `torch.save`.
fn decode(bytes: &[u8]) -> Option<Result<Tensors, Reason>> {
    match bytes {
        b if b.starts_with(ARCHIVE) => Some(archive(bytes)),
        b if b.starts_with(LEGACY) => Some(legacy(bytes)),
        _ => None,
    }
}

/// PyTorch 1.6 and later: an archive without compression, with the pickle and a file per storage.
fn archive(bytes: &[u8]) -> Result<Tensors, Reason> {
    let files = files_of(bytes)?;
    let mut pickles = files.iter().filter(|(name, _)| name.ends_with("/data.pkl"));
    let (Some((name, range)), None) = (pickles.next(), pickles.next()) else {
        return other("the archive holds no data.pkl, or several");
    };
    let root = name.trim_end_matches("data.pkl");
    if files.get(&format!("{root}byteorder")).is_some_and(|range| bytes[range.clone()] != *b"little") {
        return other("its numbers are big-endian, expected little-endian");
    }
    let pickle = Pickle::read(&bytes[range.clone()])?;
    let place = |storage: &Storage| files.get(&format!("{root}data/{}", storage.key)).cloned();
    tensors(&pickle, bytes, place)
}

/// Before: pickles of the magic number, version, system and object, then of the storages' keys, then the storages.
fn legacy(bytes: &[u8]) -> Result<Tensors, Reason> {
    let mut at = 0;
    let mut next = || {
        let pickle = Pickle::read(&bytes[at..])?;
        at += pickle.length;
        Ok::<_, Reason>(pickle)
    };
    let (_magic, _version, system, object, keys) = (next()?, next()?, next()?, next()?, next()?);
    if !system.entries(system.root()).any(|entry| entry == ("little_endian", &Object::Bool(true))) {
        return other("its numbers aren't little-endian");
    }
    let known =
        object.objects().iter().filter_map(|o| if let Object::Storage(s) = o { Some((s.key.as_str(), s)) } else { None });
    let known: BTreeMap<&str, &Storage> = known.collect();
    let Object::List(list) = keys.root() else { return other("it has no list of storages") };
    let mut places = BTreeMap::new();
    for key in list {
        let Object::Text(key) = keys.object(*key) else { return other("a storage has no name") };
        let Some(storage) = known.get(key.as_str()) else { return other(format!("no tensor has the storage `{key}`")) };
        let Some(size) = size_of_number(&storage.class) else { return other(format!("it holds `{}`", storage.class)) };
        let Some(count) = bytes.get(at..).and_then(|rest| rest.first_chunk::<8>()) else {
            return other(format!("it ends before storage `{key}`"));
        };
        let count = usize::try_from(i64::from_le_bytes(*count)).ok().filter(|count| *count == storage.count);
        let end = count.and_then(|count| count.checked_mul(size)).and_then(|length| length.checked_add(at + 8));
        match end.filter(|end| *end <= bytes.len()) {
            Some(end) => {
                places.insert(key.clone(), at + 8..end);
                at = end;
            }
            None => return other(format!("it ends within storage `{key}`")),
        }
    }
    tensors(&object, bytes, |storage: &Storage| places.get(&storage.key).cloned())
}

/// Where the files of an archive lie, from the directory at its end.
fn files_of(bytes: &[u8]) -> Result<BTreeMap<String, Range<usize>>, Reason> {
    let short = || Reason::Other("the archive is cut short".into());
    let u16_at = |at: usize| {
        bytes.get(at..).and_then(|b| b.first_chunk()).map(|b| usize::from(u16::from_le_bytes(*b))).ok_or_else(short)
    };
    let u32_at =
        |at: usize| bytes.get(at..).and_then(|b| b.first_chunk()).map(|b| u32::from_le_bytes(*b) as usize).ok_or_else(short);
    // The end record has 22 bytes and a comment of up to 65535.
    let from = bytes.len().saturating_sub(22 + 0xffff);
    let end = bytes[from..].windows(4).rposition(|w| w == b"PK\x05\x06").map(|at| from + at).ok_or_else(short)?;
    if bytes.len() < end + 22 {
        return Err(short());
    }
    let (count, mut at) = (u16_at(end + 10)?, u32_at(end + 16)?);
    let mut files = BTreeMap::new();
    for _ in 0..count {
        if bytes.get(at..at + 4) != Some(b"PK\x01\x02") {
            return Err(short());
        }
        let (flags, method, length) = (u16_at(at + 8)?, u16_at(at + 10)?, u32_at(at + 24)?);
        let (name, extra, comment, local) = (u16_at(at + 28)?, u16_at(at + 30)?, u16_at(at + 32)?, u32_at(at + 42)?);
        let name = bytes.get(at + 46..at + 46 + name).ok_or_else(short)?;
        at += 46 + name.len() + extra + comment;
        let name = String::from_utf8_lossy(name).into_owned();
        if method != 0 || flags & 1 != 0 {
            return other(format!("`{name}` in it is compressed or encrypted, which `torch.save` doesn't do"));
        }
        if bytes.get(local..local + 4) != Some(ARCHIVE) {
            return Err(short());
        }
        let start = local + 30 + u16_at(local + 26)? + u16_at(local + 28)?;
        let range = start..start + length;
        if range.end > bytes.len() {
            return Err(short());
        }
        files.insert(name, range);
    }
    Ok(files)
}

/// The tensors of the state dict, the outermost dictionary or one that a training program keeps in it.
fn tensors(pickle: &Pickle, bytes: &[u8], place: impl Fn(&Storage) -> Option<Range<usize>>) -> Result<Tensors, Reason> {
    let inner =
        pickle.entries(pickle.root()).find(|(key, value)| STATE_DICTS.contains(key) && matches!(value, Object::Dict(_)));
    let state = inner.map_or(pickle.root(), |(_, value)| value);
    let mut found = Tensors::new();
    let mut room = bytes.len();
    for (name, value) in pickle.entries(state) {
        let Object::Tensor(view) = value else { continue };
        let Some(range) = place(&view.storage) else { return other(format!("the numbers of `{name}` are missing")) };
        // Tensors may overlap, but not hold more numbers together than the file has bytes.
        room = match room.checked_sub(count_of(view).unwrap_or(usize::MAX)) {
            Some(left) => left,
            None => return other(format!("the tensors up to `{name}` are larger than the file")),
        };
        let values = values(view, &bytes[range]).map_err(|reason| Reason::Other(format!("`{name}` {reason}")))?;
        found.insert(name.to_string(), StoredTensor { shape: view.shape.clone(), values });
    }
    if found.is_empty() {
        let keys: BTreeSet<&str> = pickle.entries(pickle.root()).map(|(key, _)| key).take(8).collect();
        return other(format!("it holds no state dict with tensors (outermost entries: {keys:?})"));
    }
    Ok(found)
}

/// Numbers of a tensor.
fn count_of(view: &View) -> Option<usize> {
    view.shape.iter().try_fold(1usize, |count, side| count.checked_mul(*side))
}

/// The numbers of a view of a storage, last axis fastest.
fn values(view: &View, storage: &[u8]) -> Result<Vec<f32>, String> {
    let size = size_of_number(&view.storage.class).filter(|_| is_float(&view.storage.class));
    let size = size.ok_or_else(|| format!("holds `{}`, expected floats", view.storage.class))?;
    let count = count_of(view).ok_or("has an impossible shape")?;
    if count == 0 {
        return Ok(Vec::new());
    }
    let reach = view
        .shape
        .iter()
        .zip(&view.strides)
        .try_fold(view.offset, |reach, (side, stride)| reach.checked_add((side - 1).checked_mul(*stride)?));
    if reach.is_none_or(|last| last >= storage.len() / size) {
        return Err(format!("reaches beyond its storage of {} numbers", storage.len() / size));
    }
    let number = |at: usize| float(&view.storage.class, &storage[at * size..(at + 1) * size]);
    let mut index = vec![0; view.shape.len()];
    let mut values = Vec::with_capacity(count);
    let mut at = view.offset;
    for _ in 0..count {
        values.push(number(at));
        for axis in (0..index.len()).rev() {
            if index[axis] + 1 < view.shape[axis] {
                index[axis] += 1;
                at += view.strides[axis];
                break;
            }
            at -= index[axis] * view.strides[axis];
            index[axis] = 0;
        }
    }
    if values.iter().all(|v| v.is_finite()) { Ok(values) } else { Err("holds a value that is no finite number".into()) }
}

fn is_float(class: &str) -> bool {
    ["torch.FloatStorage", "torch.DoubleStorage", "torch.HalfStorage", "torch.BFloat16Storage"].contains(&class)
}

/// Bytes of a number of a storage.
fn size_of_number(class: &str) -> Option<usize> {
    Some(match class.strip_prefix("torch.")?.strip_suffix("Storage")? {
        "Double" | "Long" | "ComplexFloat" => 8,
        "Float" | "Int" => 4,
        "Half" | "BFloat16" | "Short" => 2,
        "Char" | "Byte" | "Bool" => 1,
        "ComplexDouble" => 16,
        _ => return None,
    })
}

/// A little-endian number of a storage of floats.
fn float(class: &str, bytes: &[u8]) -> f32 {
    match (class, bytes) {
        ("torch.DoubleStorage", &[a, b, c, d, e, f, g, h]) => f64::from_le_bytes([a, b, c, d, e, f, g, h]) as f32,
        ("torch.BFloat16Storage", &[a, b]) => bf16::from_le_bytes([a, b]).to_f32(),
        (_, &[a, b]) => f16::from_le_bytes([a, b]).to_f32(),
        (_, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
        _ => f32::NAN,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fixture(folder: &str) -> Vec<u8> {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/flow").join(folder).join("pwc_net.pth.tar");
        fs::read(path).unwrap()
    }

    const BOTH: [&str; 2] = ["release", "release-first-version"];

    #[test]
    fn both_containers_are_read() {
        for (folder, name) in BOTH.into_iter().zip(["conv1a.0.weight", "module.conv1a.0.weight"]) {
            let tensors = decode(&fixture(folder)).unwrap().unwrap();
            assert_eq!(tensors[name].shape, [2, 3, 3, 3]);
            assert!(tensors[name].values.iter().all(|v| *v != 0.0 && v.abs() < 3.0));
        }
    }

    #[test]
    fn cut_and_changed_checkpoints_end_in_an_error_or_in_tensors() {
        for folder in BOTH {
            let whole = fixture(folder);
            for length in (0..whole.len()).step_by(97).chain(whole.len() - 30..whole.len()) {
                if let Some(result) = decode(&whole[..length]) {
                    assert!(result.is_err(), "{folder}: {length} of {} bytes", whole.len());
                }
            }
            // Everything but the numbers lies at both ends.
            for at in (0..2000).chain(whole.len() - 2000..whole.len()) {
                let mut changed = whole.clone();
                changed[at] ^= [0xff, 0x80, 1][at % 3];
                if let Some(Ok(tensors)) = decode(&changed) {
                    assert!(tensors.values().all(|t| t.shape.iter().product::<usize>() == t.values.len()));
                }
            }
        }
    }

    fn view(shape: &[usize], strides: &[usize], offset: usize) -> View {
        let storage = Storage { class: "torch.FloatStorage".into(), key: "0".into(), count: 6 };
        View { storage, offset, shape: shape.to_vec(), strides: strides.to_vec() }
    }

    #[test]
    fn views_of_a_storage_are_gathered() {
        let storage: Vec<u8> = (0..6).flat_map(|i| (i as f32).to_le_bytes()).collect();
        let read = |shape: &[usize], strides: &[usize], offset| values(&view(shape, strides, offset), &storage);
        assert_eq!(read(&[2, 3], &[3, 1], 0).unwrap(), [0., 1., 2., 3., 4., 5.]);
        assert_eq!(read(&[3, 2], &[1, 3], 0).unwrap(), [0., 3., 1., 4., 2., 5.]);
        assert_eq!(read(&[2], &[2], 1).unwrap(), [1., 3.]);
        assert_eq!(read(&[], &[], 5).unwrap(), [5.]);
        assert_eq!(read(&[3, 0], &[1, 1], 0).unwrap(), [0.0; 0]);
        assert_eq!(read(&[1, 2], &[usize::MAX, 1], 3).unwrap(), [3., 4.]);
        for (shape, strides, offset) in [(vec![7], vec![1], 0), (vec![1], vec![1], 6), (vec![2], vec![usize::MAX], 1)] {
            assert!(read(&shape, &strides, offset).unwrap_err().contains("beyond"));
        }
        assert!(values(&view(&[usize::MAX, 3], &[0, 0], 0), &storage).is_err());
        let integers =
            View { storage: Storage { class: "torch.LongStorage".into(), ..view(&[], &[], 0).storage }, ..view(&[], &[], 0) };
        assert!(values(&integers, &storage).unwrap_err().contains("expected floats"));
    }
}
