//! What PyTorch's calls and references mean.

use super::machine::Machine;
use super::{Id, Object, PickleError, Storage, View};

impl Machine<'_> {
    /// A function and its arguments. Those that rebuild tensors and ordered dictionaries are known; the others aren't called.
    pub fn reduce(&mut self) -> Result<(), PickleError> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let Object::Tuple(arguments) = &self.objects[arguments] else { return self.wrong("arguments that are no tuple") };
        let Object::Global(function) = &self.objects[function] else {
            return self.wrong("a call of something that is no function");
        };
        let argument = |index: usize| arguments.get(index).map(|id| &self.objects[*id]);
        let made = match function.as_str() {
            "collections.OrderedDict" => self.dictionary(argument(0)),
            "torch._utils._rebuild_tensor" | "torch._utils._rebuild_tensor_v2" => self.view([0, 1, 2, 3].map(argument)),
            "torch._utils._rebuild_parameter" => match argument(0) {
                Some(Object::Tensor(view)) => Ok(Object::Tensor(view.clone())),
                _ => Err("a parameter without a tensor"),
            },
            _ => Ok(Object::Opaque),
        };
        match made {
            Ok(made) => self.push(made),
            Err(what) => self.wrong(what),
        }
    }

    /// A dictionary of a list of pairs.
    fn dictionary(&self, items: Option<&Object>) -> Result<Object, &'static str> {
        let items = match items {
            None => return Ok(Object::Dict(Vec::new())),
            Some(Object::List(items)) => items,
            Some(_) => return Err("a dictionary of something else than pairs"),
        };
        let pairs = items.iter().map(|item| match &self.objects[*item] {
            Object::Tuple(pair) | Object::List(pair) => <[Id; 2]>::try_from(pair.as_slice()).ok().map(|[k, v]| (k, v)),
            _ => None,
        });
        pairs.collect::<Option<_>>().map(Object::Dict).ok_or("a dictionary of something else than pairs")
    }

    /// A tensor of a storage, the place of its first number, its shape and its strides.
    fn view(&self, arguments: [Option<&Object>; 4]) -> Result<Object, &'static str> {
        let [Some(Object::Storage(storage)), Some(Object::Int(offset)), Some(shape), Some(strides)] = arguments else {
            return Err("a tensor without storage, place, shape and strides");
        };
        let numbers = usize::try_from(*offset).ok().zip(self.sizes(shape)).zip(self.sizes(strides));
        match numbers {
            Some(((offset, shape), strides)) if shape.len() == strides.len() => {
                Ok(Object::Tensor(View { storage: storage.clone(), offset, shape, strides }))
            }
            _ => Err("a tensor of impossible shape"),
        }
    }

    fn sizes(&self, object: &Object) -> Option<Vec<usize>> {
        let Object::Tuple(items) = object else { return None };
        let size = |id: &Id| if let Object::Int(size) = self.objects[*id] { usize::try_from(size).ok() } else { None };
        items.iter().map(size).collect()
    }

    /// A reference to a storage: ("storage", class, key, device, count) and, in old files, a part of it.
    pub fn persistent(&mut self) -> Result<(), PickleError> {
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
