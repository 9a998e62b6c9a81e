//! Decoded materials within a byte budget, shared by all workers.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use crate::material::error::MaterialError;
use crate::material::stored::Material;

#[derive(Debug, Default)]
struct Kept {
    /// Per entry: the material and when it was last asked for.
    materials: HashMap<usize, (Arc<Material>, u64)>,
    bytes: usize,
    clock: u64,
}

/// A least-recently-used cache. Materials still in use elsewhere live on after they leave it.
#[derive(Debug)]
pub(super) struct MaterialCache {
    kept: Mutex<Kept>,
    /// One lock per entry, so that two workers don't decode the same material at the same time.
    loading: Vec<Mutex<()>>,
    budget: usize,
}

impl MaterialCache {
    pub(super) fn new(entries: usize, budget: usize) -> Self {
        Self { kept: Mutex::default(), loading: (0..entries).map(|_| Mutex::new(())).collect(), budget }
    }

    /// The material of an entry, loaded if it isn't kept.
    pub(super) fn get(
        &self,
        entry: usize,
        load: impl FnOnce() -> Result<Material, MaterialError>,
    ) -> Result<Arc<Material>, MaterialError> {
        if let Some(material) = self.find(entry) {
            return Ok(material);
        }
        // A poisoned lock only says that another worker panicked while loading; what it guards is still whole.
        let _loading = self.loading[entry].lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(material) = self.find(entry) {
            return Ok(material);
        }
        let material = Arc::new(load()?);
        self.keep(entry, &material);
        Ok(material)
    }

    /// Bytes of the kept materials.
    pub(super) fn bytes(&self) -> usize {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner).bytes
    }

    fn find(&self, entry: usize) -> Option<Arc<Material>> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.clock += 1;
        let now = kept.clock;
        let (material, last_used) = kept.materials.get_mut(&entry)?;
        *last_used = now;
        Some(material.clone())
    }

    fn keep(&self, entry: usize, material: &Arc<Material>) {
        let bytes = material.bytes();
        if bytes > self.budget {
            return;
        }
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        while kept.bytes + bytes > self.budget {
            let oldest = kept.materials.iter().min_by_key(|(_, (_, last_used))| *last_used).map(|(entry, _)| *entry);
            let Some((dropped, _)) = oldest.and_then(|entry| kept.materials.remove(&entry)) else { break };
            kept.bytes -= dropped.bytes();
        }
        kept.clock += 1;
        let now = kept.clock;
        if kept.materials.insert(entry, (material.clone(), now)).is_none() {
            kept.bytes += bytes;
        }
    }
}
