//! The part of Python's pickle format that checkpoints of tensors use, read as data: nothing that a file names is ever run.
//!
//! Objects lie in one list and refer to each other by index, so that a file can neither nest them too deeply to be freed nor
//! multiply them by repetition.
//!
//! # Source
//! Python's `pickletools` (opcodes of protocols 2 to 4); PyTorch's `torch/serialization.py` and `torch/_utils.py` (storages and
//! how tensors are rebuilt from them).

mod bytes;
mod machine;
#[cfg(test)]
mod tests;
mod torch;

use machine::Machine;

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
        let mut machine = Machine::new(bytes);
        for _ in 0..MOST_STEPS {
            if let Some(root) = machine.step()? {
                return Ok(Self { objects: machine.objects, root, length: machine.bytes.at });
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
