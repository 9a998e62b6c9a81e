//! TensorBoard's event files: records of protocol buffers, one after the other.
//!
//! A record is its length (8 bytes, little endian), a checksum of that, the bytes, and a checksum of those. Messages are made by
//! tensorboard-rs; its own writer isn't used, because it loses what is on its way when the process is killed, panics where
//! the disk is full, and can't take back what a resumed run repeats.

use protobuf::Message;
use std::fs::{File, OpenOptions};
use std::io::{self, BufReader, BufWriter, Read};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};
use tensorboard_rs::record_writer::RecordWriter;

/// What TensorBoard looks for in the names of files.
const MARK: &str = "tfevents";
/// The first record of every file.
const VERSION: &str = "brain.Event:2";
/// Bytes around a record's own: length and checksum before it, checksum after it.
const LENGTH: usize = 8;
const CHECKSUM: usize = 4;
/// Fields of the message `Event`, as field number and wire type in one byte, and those of `Summary` and its `Value`.
const WALL_TIME: u8 = 1 << 3 | 1;
const STEP: u8 = 2 << 3;
const FILE_VERSION: u8 = 3 << 3 | 2;
const SUMMARY: u8 = 5 << 3 | 2;
const VALUE: u8 = 1 << 3 | 2;
const TAG: u8 = 1 << 3 | 2;

/// An event file that this process writes.
pub struct EventFile {
    records: RecordWriter<BufWriter<File>>,
}

impl EventFile {
    /// Starts a file of its own in a folder.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn create(folder: &Path) -> io::Result<Self> {
        let (seconds, process) = (now() as u64, std::process::id());
        let name = |number: usize| folder.join(format!("events.out.{MARK}.{seconds:010}.{process}.{number}"));
        let open = |path: PathBuf| OpenOptions::new().write(true).create_new(true).open(path);
        // A run that goes back within a second starts a second file.
        let file = (0..)
            .map(|number| open(name(number)))
            .find(|opened| !opened.as_ref().is_err_and(|error| error.kind() == io::ErrorKind::AlreadyExists));
        let file = file.unwrap_or_else(|| Err(io::ErrorKind::AlreadyExists.into()))?;
        let mut records = RecordWriter::new(BufWriter::new(file));
        let mut event = begin();
        field(&mut event, FILE_VERSION, VERSION.as_bytes());
        records.write(&event)?;
        Ok(Self { records })
    }

    /// Adds values of a step.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn add(&mut self, summary: &impl Message, step: u64) -> io::Result<()> {
        let mut event = begin();
        event.push(STEP);
        push_varint(&mut event, step);
        field(&mut event, SUMMARY, &summary.write_to_bytes().map_err(io::Error::other)?);
        self.records.write(&event)
    }

    /// Brings everything to the file.
    ///
    /// # Errors
    /// The system's refusal.
    pub fn flush(&mut self) -> io::Result<()> {
        self.records.flush()
    }
}

/// Takes every value of a stage after a step out of the event files of a folder, and what a kill left half-written at their ends.
/// A tag belongs to the stage when it begins with its name and `/` or `-`. Tells whether any file had to be written anew.
///
/// # Errors
/// The system's refusal.
pub fn rewind(folder: &Path, stage: &str, step: u64) -> io::Result<bool> {
    let mut changed = false;
    for entry in std::fs::read_dir(folder)? {
        let path = entry?.path();
        if path.file_name().and_then(|name| name.to_str()).is_some_and(|name| name.contains(MARK)) {
            changed |= rewind_file(&path, stage, step)?;
        }
    }
    Ok(changed)
}

fn rewind_file(path: &Path, stage: &str, step: u64) -> io::Result<bool> {
    let is_repeated = |record: &[u8]| {
        let (at, tag) = step_and_tag(event_of(record)).unwrap_or_default();
        at > step && tag.strip_prefix(stage.as_bytes()).is_some_and(|rest| matches!(rest.first(), Some(b'/' | b'-')))
    };
    let (mut read, mut repeated) = (0, false);
    each_record(path, |record| {
        read += record.len() as u64;
        repeated |= is_repeated(record);
        Ok(())
    })?;
    // Most files of most stages hold nothing to take out.
    if !repeated && read == std::fs::metadata(path)?.len() {
        return Ok(false);
    }
    crate::atomic::write_with(path, |kept| {
        each_record(path, |record| if is_repeated(record) { Ok(()) } else { kept.write_all(record) })
    })?;
    Ok(true)
}

/// Goes through a file's whole records, each with all that is around it.
fn each_record(path: &Path, mut take: impl FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
    let mut file = BufReader::new(File::open(path)?);
    while let Some(record) = next_record(&mut file)? {
        take(&record)?;
    }
    Ok(())
}

/// The event in a record.
fn event_of(record: &[u8]) -> &[u8] {
    &record[LENGTH + CHECKSUM..record.len() - CHECKSUM]
}

/// The next record with all that is around it; `None` at the end, whole or torn.
fn next_record(file: &mut impl Read) -> io::Result<Option<Vec<u8>>> {
    let mut record = Vec::new();
    file.take((LENGTH + CHECKSUM) as u64).read_to_end(&mut record)?;
    let Some(length) = record.first_chunk().map(|bytes| u64::from_le_bytes(*bytes)) else { return Ok(None) };
    let rest = length.saturating_add(CHECKSUM as u64);
    let found = file.take(rest).read_to_end(&mut record)?;
    Ok((found as u64 == rest).then_some(record))
}

/// Step of an event and the tag of its first value; `None` for events of other kinds.
fn step_and_tag(event: &[u8]) -> Option<(u64, &[u8])> {
    let (mut step, mut rest) = (0, event);
    while let Some((&key, after)) = rest.split_first() {
        match key {
            WALL_TIME => rest = after.get(8..)?,
            STEP => (step, rest) = varint(after)?,
            SUMMARY => return Some((step, first_of(first_of(delimited(after)?, VALUE)?, TAG)?)),
            _ if key & 7 == 2 => {
                let (length, after) = varint(after)?;
                rest = after.get(usize::try_from(length).ok()?..)?;
            }
            _ => return None,
        }
    }
    None
}

/// The bytes of a message's first field, if it is the one that is looked for.
fn first_of(message: &[u8], key: u8) -> Option<&[u8]> {
    let (&first, after) = message.split_first()?;
    if first == key { delimited(after) } else { None }
}

fn delimited(bytes: &[u8]) -> Option<&[u8]> {
    let (length, rest) = varint(bytes)?;
    rest.get(..usize::try_from(length).ok()?)
}

fn varint(bytes: &[u8]) -> Option<(u64, &[u8])> {
    let end = bytes.iter().take(10).position(|byte| byte & 0x80 == 0)?;
    let value = bytes[..=end].iter().rev().fold(0_u64, |value, byte| value << 7 | u64::from(byte & 0x7f));
    Some((value, &bytes[end + 1..]))
}

fn push_varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 0x80 {
        bytes.push(value as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

fn field(bytes: &mut Vec<u8>, key: u8, content: &[u8]) {
    bytes.push(key);
    push_varint(bytes, content.len() as u64);
    bytes.extend_from_slice(content);
}

/// An event of this moment.
fn begin() -> Vec<u8> {
    let mut event = vec![WALL_TIME];
    event.extend_from_slice(&now().to_le_bytes());
    event
}

fn now() -> f64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64())
}

/// Step, tag and number of every scalar in the event files of a folder.
///
/// # Errors
/// The system's refusal.
pub fn read_scalars(folder: &Path) -> io::Result<Vec<(u64, String, f32)>> {
    /// `simple_value` of a `Value`, a single, which stands last.
    const NUMBER: u8 = 2 << 3 | 5;
    let mut scalars = Vec::new();
    for entry in std::fs::read_dir(folder)? {
        each_record(&entry?.path(), |record| {
            let event = event_of(record);
            if let Some((step, tag)) = step_and_tag(event)
                && let Some([NUMBER, number @ ..]) = event.last_chunk::<5>()
            {
                scalars.push((step, String::from_utf8_lossy(tag).into_owned(), f32::from_le_bytes(*number)));
            }
            Ok(())
        })?;
    }
    Ok(scalars)
}

#[cfg(test)]
mod tests {
    use super::*;
    use tensorboard_rs::summary::scalar;

    fn steps(folder: &Path) -> Vec<(String, u64, f32)> {
        let mut found: Vec<_> =
            read_scalars(folder).unwrap().into_iter().map(|(step, tag, value)| (tag, step, value)).collect();
        found.sort_by(|a, b| a.partial_cmp(b).unwrap());
        found
    }

    fn write(folder: &Path, rows: &[(&str, u64)]) {
        let mut file = EventFile::create(folder).unwrap();
        for (tag, step) in rows {
            file.add(&scalar(tag, *step as f32 / 3.0), *step).unwrap();
        }
        file.flush().unwrap();
    }

    #[test]
    fn going_back_takes_out_the_later_values_of_the_stage_only() {
        let home = tempfile::tempdir().unwrap();
        write(home.path(), &[("adjacent/loss", 1), ("adjacent/loss", 900), ("svbrdf/loss", 1), ("svbrdf-held-out/x", 2)]);
        write(home.path(), &[("svbrdf/loss", 300), ("svbrdf/top", 301), ("svbrdf-held-out/x", 301), ("svbrdfs/x", 999)]);
        rewind(home.path(), "svbrdf", 300).unwrap();
        let expected = [
            ("adjacent/loss", 1),
            ("adjacent/loss", 900),
            ("svbrdf-held-out/x", 2),
            ("svbrdf/loss", 1),
            ("svbrdf/loss", 300),
            ("svbrdfs/x", 999),
        ];
        assert_eq!(steps(home.path()), expected.map(|(tag, step)| (tag.to_string(), step, step as f32 / 3.0)));
        assert_eq!(std::fs::read_dir(home.path()).unwrap().count(), 2);
    }

    #[test]
    fn files_with_nothing_to_take_out_stay_untouched() {
        let home = tempfile::tempdir().unwrap();
        write(home.path(), &[("adjacent/loss", 1)]);
        let path = std::fs::read_dir(home.path()).unwrap().next().unwrap().unwrap().path();
        let before = std::fs::metadata(&path).unwrap();
        rewind(home.path(), "adjacent", 1).unwrap();
        assert_eq!(before.modified().unwrap(), std::fs::metadata(&path).unwrap().modified().unwrap());
    }

    #[test]
    fn a_record_that_a_kill_tore_is_taken_out_wherever_it_was_torn() {
        let home = tempfile::tempdir().unwrap();
        write(home.path(), &[("adjacent/loss", 1), ("adjacent/loss", 2)]);
        let path = std::fs::read_dir(home.path()).unwrap().next().unwrap().unwrap().path();
        let whole = std::fs::read(&path).unwrap();
        let mut file = BufReader::new(File::open(&path).unwrap());
        let records: Vec<usize> = std::iter::from_fn(|| next_record(&mut file).unwrap()).map(|record| record.len()).collect();
        let last = whole.len() - records[2];
        for cut in last + 1..whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            rewind(home.path(), "adjacent", 9).unwrap();
            assert_eq!(std::fs::read(&path).unwrap(), whole[..last], "cut at {cut}");
        }
    }

    #[test]
    fn large_steps_and_tags_are_read_as_written() {
        let home = tempfile::tempdir().unwrap();
        let tag = format!("adjacent/{}", "x".repeat(300));
        write(home.path(), &[(&tag, 1 << 40)]);
        assert_eq!(steps(home.path()), [(tag, 1 << 40, (1_u64 << 40) as f32 / 3.0)]);
    }
}
