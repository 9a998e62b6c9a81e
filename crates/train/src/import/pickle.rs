//! The part of Python's pickle format that checkpoints of tensors use, read as data: nothing that a file names is ever run.
//!
//! Objects lie in one list and refer to each other by index, so that a file can neither nest them too deeply to be freed nor
//! multiply them by repetition.
//!
//! # Source
//! Python's `pickletools` (opcodes of protocols 2 to 4); PyTorch's `torch/serialization.py` and `torch/_utils.py` (storages and
//! how tensors are rebuilt from them).

use std::collections::HashMap;

/// Most objects of a pickle; a state dict has about twenty per tensor.
const MOST_OBJECTS: usize = 1 << 20;
/// Most instructions.
const MOST_STEPS: usize = 1 << 23;

/// Index of an object.
pub type Id = usize;

/// A value.
#[derive(Clone, Debug, PartialEq)]
pub enum Object {
    /// None, floats, bytes, and whatever a checkpoint's tensors don't need.
    Opaque,
    /// A truth value.
    Bool(bool),
    /// An integer.
    Int(i64),
    /// A string.
    Text(String),
    /// A tuple.
    Tuple(Vec<Id>),
    /// A list.
    List(Vec<Id>),
    /// A dictionary.
    Dict(Vec<(Id, Id)>),
    /// A class or function, by name.
    Global(String),
    /// Numbers somewhere in the file.
    Storage(Storage),
    /// A view of a storage.
    Tensor(View),
}

/// Numbers that lie somewhere else in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Storage {
    /// The storage's class, for example `torch.FloatStorage`.
    pub class: String,
    /// Its name in the file.
    pub key: String,
    /// How many numbers it has.
    pub count: usize,
}

/// A tensor.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct View {
    /// Where its numbers lie.
    pub storage: Storage,
    /// The first of them.
    pub offset: usize,
    /// Its shape.
    pub shape: Vec<usize>,
    /// Steps between neighbours along each axis, in numbers.
    pub strides: Vec<usize>,
}

/// A pickle that was read.
#[derive(Debug)]
pub struct Pickle {
    objects: Vec<Object>,
    root: Id,
    /// Bytes that it took.
    pub length: usize,
}

/// Why a pickle can't be read.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PickleError {
    /// The bytes end before the pickle does.
    #[error("it ends in the middle of a pickle, at byte {at}")]
    Short {
        /// Bytes there are.
        at: usize,
    },
    /// An instruction that checkpoints don't use.
    #[error("its pickle has the instruction {code:#04x} at byte {at}, which checkpoints of tensors don't use")]
    Instruction {
        /// The instruction.
        code: u8,
        /// Where.
        at: usize,
    },
    /// An instruction on values that it isn't for.
    #[error("its pickle goes wrong at byte {at}: {what}")]
    Wrong {
        /// Where.
        at: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// More than a checkpoint needs.
    #[error("its pickle has more than {MOST_OBJECTS} objects or {MOST_STEPS} instructions, which no checkpoint of a net needs")]
    TooLarge,
}

impl Pickle {
    /// Reads the pickle that the bytes begin with.
    ///
    /// # Errors
    /// See [`PickleError`].
    pub fn read(bytes: &[u8]) -> Result<Self, PickleError> {
        let mut machine =
            Machine { bytes, at: 0, objects: Vec::new(), stack: Vec::new(), marks: Vec::new(), memo: HashMap::new() };
        for _ in 0..MOST_STEPS {
            if let Some(root) = machine.step()? {
                return Ok(Self { objects: machine.objects, root, length: machine.at });
            }
        }
        Err(PickleError::TooLarge)
    }

    /// The object at an index.
    pub fn object(&self, id: Id) -> &Object {
        &self.objects[id]
    }

    /// The outermost object.
    pub fn root(&self) -> &Object {
        self.object(self.root)
    }

    /// All objects, in the order in which they came.
    pub fn objects(&self) -> &[Object] {
        &self.objects
    }

    /// The entries of a dictionary whose keys are strings; of other objects none.
    pub fn entries<'a>(&'a self, object: &'a Object) -> impl Iterator<Item = (&'a str, &'a Object)> {
        let pairs = if let Object::Dict(pairs) = object { pairs.as_slice() } else { &[] };
        pairs.iter().filter_map(|(key, value)| match self.object(*key) {
            Object::Text(key) => Some((key.as_str(), self.object(*value))),
            _ => None,
        })
    }
}

struct Machine<'a> {
    bytes: &'a [u8],
    at: usize,
    objects: Vec<Object>,
    stack: Vec<Id>,
    /// Heights of the stack.
    marks: Vec<usize>,
    memo: HashMap<usize, Id>,
}

impl Machine<'_> {
    /// One instruction; the outermost object when it was the last.
    fn step(&mut self) -> Result<Option<Id>, PickleError> {
        let at = self.at;
        let code = self.byte()?;
        match code {
            // PROTO, FRAME
            0x80 => drop(self.byte()?),
            0x95 => drop(self.take(8)?),
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
                self.take(8)?;
                self.push(Object::Opaque)?;
            }
            b'J' => {
                let value = i64::from(i32::from_le_bytes(self.array()?));
                self.push(Object::Int(value))?;
            }
            b'K' => {
                let value = i64::from(self.byte()?);
                self.push(Object::Int(value))?;
            }
            b'M' => {
                let value = i64::from(u16::from_le_bytes(self.array()?));
                self.push(Object::Int(value))?;
            }
            0x8a => self.long()?,
            // SHORT_BINUNICODE, BINUNICODE, BINUNICODE8; SHORT_BINSTRING, BINSTRING of Python 2
            0x8c | b'U' => {
                let length = usize::from(self.byte()?);
                self.text(length)?;
            }
            b'X' | b'T' => {
                let length = self.size4()?;
                self.text(length)?;
            }
            0x8d => {
                let length = self.size8()?;
                self.text(length)?;
            }
            // SHORT_BINBYTES, BINBYTES
            b'C' => {
                let length = usize::from(self.byte()?);
                self.skip(length)?;
            }
            b'B' => {
                let length = self.size4()?;
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
                let place = usize::from(self.byte()?);
                self.put(place)?;
            }
            b'r' => {
                let place = self.size4()?;
                self.put(place)?;
            }
            0x94 => self.put(self.memo.len())?,
            b'h' => {
                let place = usize::from(self.byte()?);
                self.get(place)?;
            }
            b'j' => {
                let place = self.size4()?;
                self.get(place)?;
            }
            b'c' => {
                let name = format!("{}.{}", self.line()?, self.line()?);
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

    fn wrong<T>(&self, what: &'static str) -> Result<T, PickleError> {
        Err(PickleError::Wrong { at: self.at, what })
    }

    fn take(&mut self, count: usize) -> Result<&[u8], PickleError> {
        let end = self.at.checked_add(count).filter(|end| *end <= self.bytes.len());
        let end = end.ok_or(PickleError::Short { at: self.bytes.len() })?;
        let taken = &self.bytes[self.at..end];
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], PickleError> {
        Ok(self.take(N)?.try_into().expect("so many were taken"))
    }

    fn byte(&mut self) -> Result<u8, PickleError> {
        Ok(self.array::<1>()?[0])
    }

    fn size4(&mut self) -> Result<usize, PickleError> {
        Ok(u32::from_le_bytes(self.array()?) as usize)
    }

    fn size8(&mut self) -> Result<usize, PickleError> {
        usize::try_from(u64::from_le_bytes(self.array()?)).or_else(|_| self.wrong("a text longer than memory"))
    }

    fn line(&mut self) -> Result<String, PickleError> {
        let rest = &self.bytes[self.at..];
        let length = rest.iter().position(|b| *b == b'\n').ok_or(PickleError::Short { at: self.bytes.len() })?;
        let line = String::from_utf8_lossy(self.take(length)?).into_owned();
        self.byte()?;
        Ok(line)
    }

    fn text(&mut self, length: usize) -> Result<(), PickleError> {
        let text = String::from_utf8_lossy(self.take(length)?).into_owned();
        self.push(Object::Text(text))
    }

    fn skip(&mut self, length: usize) -> Result<(), PickleError> {
        self.take(length)?;
        self.push(Object::Opaque)
    }

    /// LONG1: little-endian two's complement of any length. Only the pickle's magic number is longer than eight bytes.
    fn long(&mut self) -> Result<(), PickleError> {
        let length = usize::from(self.byte()?);
        let digits = self.take(length)?;
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

    fn push(&mut self, object: Object) -> Result<(), PickleError> {
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

    fn pop(&mut self) -> Result<Id, PickleError> {
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

    /// A function and its arguments. Those that rebuild tensors and ordered dictionaries are known; the others aren't called.
    fn reduce(&mut self) -> Result<(), PickleError> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let Object::Tuple(arguments) = &self.objects[arguments] else { return self.wrong("arguments that are no tuple") };
        let Object::Global(function) = &self.objects[function] else {
            return self.wrong("a call of something that is no function");
        };
        let argument = |index: usize| arguments.get(index).map(|id| &self.objects[*id]);
        let made = match function.as_str() {
            "collections.OrderedDict" => match argument(0) {
                None => Object::Dict(Vec::new()),
                Some(Object::List(items)) => {
                    let pairs = items.iter().map(|item| match &self.objects[*item] {
                        Object::Tuple(pair) | Object::List(pair) => {
                            <[Id; 2]>::try_from(pair.as_slice()).ok().map(|[k, v]| (k, v))
                        }
                        _ => None,
                    });
                    match pairs.collect() {
                        Some(pairs) => Object::Dict(pairs),
                        None => return self.wrong("a dictionary of something else than pairs"),
                    }
                }
                Some(_) => return self.wrong("a dictionary of something else than pairs"),
            },
            "torch._utils._rebuild_tensor" | "torch._utils._rebuild_tensor_v2" => {
                match (argument(0), argument(1), argument(2), argument(3)) {
                    (Some(Object::Storage(storage)), Some(Object::Int(offset)), Some(shape), Some(strides)) => {
                        let view = usize::try_from(*offset).ok().zip(self.sizes(shape)).zip(self.sizes(strides));
                        let Some(((offset, shape), strides)) =
                            view.filter(|((_, shape), strides)| shape.len() == strides.len())
                        else {
                            return self.wrong("a tensor of impossible shape");
                        };
                        Object::Tensor(View { storage: storage.clone(), offset, shape, strides })
                    }
                    _ => return self.wrong("a tensor without storage, place, shape and strides"),
                }
            }
            "torch._utils._rebuild_parameter" => match argument(0) {
                Some(Object::Tensor(view)) => Object::Tensor(view.clone()),
                _ => return self.wrong("a parameter without a tensor"),
            },
            _ => Object::Opaque,
        };
        self.push(made)
    }

    fn sizes(&self, object: &Object) -> Option<Vec<usize>> {
        let Object::Tuple(items) = object else { return None };
        let size = |id: &Id| if let Object::Int(size) = self.objects[*id] { usize::try_from(size).ok() } else { None };
        items.iter().map(size).collect()
    }

    /// A reference to a storage: ("storage", class, key, device, count) and, in old files, a part of it.
    fn persistent(&mut self) -> Result<(), PickleError> {
        let id = self.pop()?;
        let Object::Tuple(parts) = &self.objects[id] else { return self.wrong("a reference that is no tuple") };
        let part = |index: usize| parts.get(index).map(|id| &self.objects[*id]);
        let storage = match (part(0), part(1), part(2), part(4), part(5)) {
            (
                Some(Object::Text(kind)),
                Some(Object::Global(class)),
                Some(Object::Text(key)),
                Some(Object::Int(count)),
                None | Some(Object::Opaque),
            ) if kind == "storage" => match usize::try_from(*count) {
                Ok(count) => Storage { class: class.clone(), key: key.clone(), count },
                Err(_) => return self.wrong("a storage of impossible size"),
            },
            _ => return self.wrong("a reference that isn't (\"storage\", class, key, device, count)"),
        };
        self.push(Object::Storage(storage))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: &[u8]) -> Pickle {
        Pickle::read(bytes).unwrap()
    }

    #[test]
    fn dictionaries_keep_their_entries() {
        // pickle.dumps({"a": 5, "b": (300, -2, "x"), "c": None}, protocol=2)
        let bytes = b"\x80\x02}q\x00(X\x01\x00\x00\x00aq\x01K\x05X\x01\x00\x00\x00bq\x02M,\x01J\xfe\xff\xff\xffX\x01\x00\x00\x00xq\x03\x87q\x04X\x01\x00\x00\x00cq\x05Nu.";
        let pickle = read(bytes);
        let entries: Vec<_> = pickle.entries(pickle.root()).collect();
        assert_eq!(entries.iter().map(|e| e.0).collect::<Vec<_>>(), ["a", "b", "c"]);
        assert_eq!((entries[0].1, entries[2].1), (&Object::Int(5), &Object::Opaque));
        let Object::Tuple(items) = entries[1].1 else { panic!("a tuple") };
        let items: Vec<_> = items.iter().map(|id| pickle.object(*id).clone()).collect();
        assert_eq!(items, [Object::Int(300), Object::Int(-2), Object::Text("x".into())]);
        assert_eq!(pickle.length, bytes.len());
    }

    #[test]
    fn calls_are_not_made() {
        // os.system("rm -rf /"), as pickles of evil attach it.
        let pickle = read(b"\x80\x02cos\nsystem\nX\x08\x00\x00\x00rm -rf /\x85R.");
        assert_eq!(pickle.root(), &Object::Opaque);
    }

    #[test]
    fn depth_and_repetition_cost_nothing() {
        let nested = [&b"\x80\x02"[..], &b"]".repeat(100_000), &b"a".repeat(99_999), b"."].concat();
        assert!(matches!(read(&nested).root(), Object::List(items) if items.len() == 1));
        // Each list holds the one before ten times.
        let mut bombs = b"\x80\x02]q\x00".to_vec();
        for _ in 0..1000 {
            bombs.extend(b"](h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00eq\x00");
        }
        bombs.push(b'.');
        assert!(matches!(read(&bombs).root(), Object::List(items) if items.len() == 10));
        let many = [&b"\x80\x02("[..], &b"N".repeat(MOST_OBJECTS + 1), b"t."].concat();
        assert_eq!(Pickle::read(&many).unwrap_err(), PickleError::TooLarge);
    }

    #[test]
    fn nonsense_is_an_error() {
        let wrong: [&[u8]; 12] =
            [b"", b"\x80", b"\x80\x02", b".", b"N", b"0.", b"(0.", b"t.", b"h\x07.", b"]NNs.", b"NNR.", b"(K\x01u."];
        for bytes in wrong {
            assert!(Pickle::read(bytes).is_err(), "{bytes:?}");
        }
        assert!(matches!(Pickle::read(b"X\xff\xff\xff\xffabc"), Err(PickleError::Short { .. })));
        assert!(matches!(Pickle::read(b"\x8d\xff\xff\xff\xff\xff\xff\xff\xffabc"), Err(PickleError::Short { .. })));
        assert!(matches!(Pickle::read(b"I5\n."), Err(PickleError::Instruction { code: b'I', at: 0 })));
    }
}
