//! The instructions.

use std::collections::HashMap;

use super::bytes::Bytes;
use super::{Id, MOST_OBJECTS, Object, PickleError};

/// The machine that a pickle is a program for.
pub struct Machine<'a> {
    pub bytes: Bytes<'a>,
    pub objects: Vec<Object>,
    stack: Vec<Id>,
    /// Heights of the stack.
    marks: Vec<usize>,
    memo: HashMap<usize, Id>,
}

impl<'a> Machine<'a> {
    pub fn new(bytes: &'a [u8]) -> Self {
        Self { bytes: Bytes::new(bytes), objects: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() }
    }

    /// One instruction; the outermost object when it was the last.
    pub fn step(&mut self) -> Result<Option<Id>, PickleError> {
        let at = self.bytes.at;
        let code = self.bytes.byte()?;
        match code {
            // PROTO, FRAME
            0x80 => drop(self.bytes.byte()?),
            0x95 => drop(self.bytes.take(8)?),
            b'.' => return self.pop().map(Some),
            b'(' => self.marks.push(self.stack.len()),
            b'0' => drop(self.pop()?),
            b'1' => drop(self.marked()?),
            b'2' => {
                let top = self.pop()?;
                self.stack.extend([top, top]);
            }
            b'N' => self.push(Object::Opaque)?,
            // NEWTRUE, NEWFALSE
            0x88 | 0x89 => self.push(Object::Bool(code == 0x88))?,
            b'G' => {
                self.bytes.take(8)?;
                self.push(Object::Opaque)?;
            }
            b'J' => {
                let value = i64::from(i32::from_le_bytes(self.bytes.array()?));
                self.push(Object::Int(value))?;
            }
            b'K' => {
                let value = i64::from(self.bytes.byte()?);
                self.push(Object::Int(value))?;
            }
            b'M' => {
                let value = i64::from(u16::from_le_bytes(self.bytes.array()?));
                self.push(Object::Int(value))?;
            }
            0x8a => self.long()?,
            // SHORT_BINUNICODE, BINUNICODE, BINUNICODE8; SHORT_BINSTRING, BINSTRING of Python 2
            0x8c | b'U' => {
                let length = usize::from(self.bytes.byte()?);
                self.text(length)?;
            }
            b'X' | b'T' => {
                let length = self.bytes.size4()?;
                self.text(length)?;
            }
            0x8d => {
                let length = self.bytes.size8()?;
                self.text(length)?;
            }
            // SHORT_BINBYTES, BINBYTES
            b'C' => {
                let length = usize::from(self.bytes.byte()?);
                self.skip(length)?;
            }
            b'B' => {
                let length = self.bytes.size4()?;
                self.skip(length)?;
            }
            b')' => self.push(Object::Tuple(Vec::new()))?,
            b']' => self.push(Object::List(Vec::new()))?,
            b'}' => self.push(Object::Dict(Vec::new()))?,
            0x8f => self.push(Object::Opaque)?,
            b't' => {
                let items = self.marked()?;
                self.push(Object::Tuple(items))?;
            }
            0x85..=0x87 => {
                let from = self.below(usize::from(code - 0x84))?;
                let items = self.stack.split_off(from);
                self.push(Object::Tuple(items))?;
            }
            b'l' => {
                let items = self.marked()?;
                self.push(Object::List(items))?;
            }
            b'd' => {
                let items = self.marked()?;
                let pairs = self.pairs(&items)?;
                self.push(Object::Dict(pairs))?;
            }
            // APPEND, APPENDS, ADDITEMS
            b'a' => {
                let item = self.pop()?;
                self.extend_list(vec![item])?;
            }
            b'e' | 0x90 => {
                let items = self.marked()?;
                self.extend_list(items)?;
            }
            b's' => {
                let from = self.below(2)?;
                let items = self.stack.split_off(from);
                self.extend_dict(&items)?;
            }
            b'u' => {
                let items = self.marked()?;
                self.extend_dict(&items)?;
            }
            // BINPUT, LONG_BINPUT, MEMOIZE; BINGET, LONG_BINGET
            b'q' => {
                let place = usize::from(self.bytes.byte()?);
                self.put(place)?;
            }
            b'r' => {
                let place = self.bytes.size4()?;
                self.put(place)?;
            }
            0x94 => self.put(self.memo.len())?,
            b'h' => {
                let place = usize::from(self.bytes.byte()?);
                self.get(place)?;
            }
            b'j' => {
                let place = self.bytes.size4()?;
                self.get(place)?;
            }
            b'c' => {
                let name = format!("{}.{}", self.bytes.line()?, self.bytes.line()?);
                self.push(Object::Global(name))?;
            }
            0x93 => {
                let (name, module) = (self.pop()?, self.pop()?);
                let global = match (&self.objects[module], &self.objects[name]) {
                    (Object::Text(module), Object::Text(name)) => Object::Global(format!("{module}.{name}")),
                    _ => return self.wrong("a class without a name"),
                };
                self.push(global)?;
            }
            b'R' => self.reduce()?,
            // NEWOBJ: class and arguments; BUILD: an object's further state
            0x81 => {
                let (_arguments, _class) = (self.pop()?, self.pop()?);
                self.push(Object::Opaque)?;
            }
            b'b' => drop(self.pop()?),
            b'Q' => self.persistent()?,
            code => return Err(PickleError::Instruction { code, at }),
        }
        Ok(None)
    }

    pub fn wrong<T>(&self, what: &'static str) -> Result<T, PickleError> {
        Err(PickleError::Wrong { at: self.bytes.at, what })
    }

    fn text(&mut self, length: usize) -> Result<(), PickleError> {
        let text = String::from_utf8_lossy(self.bytes.take(length)?).into_owned();
        self.push(Object::Text(text))
    }

    fn skip(&mut self, length: usize) -> Result<(), PickleError> {
        self.bytes.take(length)?;
        self.push(Object::Opaque)
    }

    /// LONG1: little-endian two's complement of any length. Only the pickle's magic number is longer than eight bytes.
    fn long(&mut self) -> Result<(), PickleError> {
        let length = usize::from(self.bytes.byte()?);
        let digits = self.bytes.take(length)?;
        let object = if length <= 8 {
            let sign = if digits.last().is_some_and(|b| b & 0x80 != 0) { 0xff } else { 0 };
            let mut value = [sign; 8];
            value[..length].copy_from_slice(digits);
            Object::Int(i64::from_le_bytes(value))
        } else {
            Object::Opaque
        };
        self.push(object)
    }

    pub fn push(&mut self, object: Object) -> Result<(), PickleError> {
        if self.objects.len() == MOST_OBJECTS {
            return Err(PickleError::TooLarge);
        }
        self.stack.push(self.objects.len());
        self.objects.push(object);
        Ok(())
    }

    /// Height of the stack below its last `count` values, none of which lies under a mark.
    fn below(&self, count: usize) -> Result<usize, PickleError> {
        let floor = self.marks.last().copied().unwrap_or(0);
        match self.stack.len().checked_sub(count).filter(|from| *from >= floor) {
            Some(from) => Ok(from),
            None => self.wrong("a value is missing"),
        }
    }

    pub fn pop(&mut self) -> Result<Id, PickleError> {
        let from = self.below(1)?;
        Ok(self.stack.split_off(from)[0])
    }

    /// Everything above the last mark, which goes.
    fn marked(&mut self) -> Result<Vec<Id>, PickleError> {
        match self.marks.pop() {
            Some(from) => Ok(self.stack.split_off(from)),
            None => self.wrong("a mark is missing"),
        }
    }

    fn pairs(&self, items: &[Id]) -> Result<Vec<(Id, Id)>, PickleError> {
        match items.as_chunks::<2>() {
            (pairs, []) => Ok(pairs.iter().map(|[key, value]| (*key, *value)).collect()),
            _ => self.wrong("a key without a value"),
        }
    }

    /// The object on top of the stack, which stays.
    fn top(&mut self) -> Result<&mut Object, PickleError> {
        let at = self.below(1)?;
        Ok(&mut self.objects[self.stack[at]])
    }

    fn extend_list(&mut self, items: Vec<Id>) -> Result<(), PickleError> {
        match self.top()? {
            Object::List(list) => list.extend(items),
            Object::Opaque => (),
            _ => return self.wrong("items for something that is no list"),
        }
        Ok(())
    }

    fn extend_dict(&mut self, items: &[Id]) -> Result<(), PickleError> {
        let pairs = self.pairs(items)?;
        match self.top()? {
            Object::Dict(dict) => dict.extend(pairs),
            Object::Opaque => (),
            _ => return self.wrong("entries for something that is no dictionary"),
        }
        Ok(())
    }

    fn put(&mut self, place: usize) -> Result<(), PickleError> {
        let at = self.below(1)?;
        self.memo.insert(place, self.stack[at]);
        Ok(())
    }

    fn get(&mut self, place: usize) -> Result<(), PickleError> {
        match self.memo.get(&place) {
            Some(id) => self.stack.push(*id),
            None => return self.wrong("a reference to nothing"),
        }
        Ok(())
    }
}
