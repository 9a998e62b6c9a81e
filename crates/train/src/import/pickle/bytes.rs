//! Bytes of a pickle, from the first to the last.

use super::PickleError;

/// What is still to be read.
pub struct Bytes<'a> {
    all: &'a [u8],
    /// How many were read.
    pub at: usize,
}

impl<'a> Bytes<'a> {
    pub fn new(all: &'a [u8]) -> Self {
        Self { all, at: 0 }
    }

    pub fn take(&mut self, count: usize) -> Result<&'a [u8], PickleError> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.all.len());
        let end = end.ok_or(PickleError::Short { at: self.all.len() })?;
        let taken = &self.all[self.at..end];
        self.at = end;
        Ok(taken)
    }

    pub fn array<const N: usize>(&mut self) -> Result<[u8; N], PickleError> {
        Ok(self.take(N)?.try_into().expect("so many were taken"))
    }

    pub fn byte(&mut self) -> Result<u8, PickleError> {
        Ok(self.array::<1>()?[0])
    }

    pub fn size4(&mut self) -> Result<usize, PickleError> {
        Ok(u32::from_le_bytes(self.array()?) as usize)
    }

    pub fn size8(&mut self) -> Result<usize, PickleError> {
        usize::try_from(u64::from_le_bytes(self.array()?))
            .map_err(|_| PickleError::Wrong { at: self.at, what: "a text longer than memory" })
    }

    pub fn line(&mut self) -> Result<String, PickleError> {
        let rest = &self.all[self.at..];
        let length = rest.iter().position(|b| *b == b'\n').ok_or(PickleError::Short { at: self.all.len() })?;
        let line = String::from_utf8_lossy(self.take(length)?).into_owned();
        self.byte()?;
        Ok(line)
    }
}
