//! `train import`: PWC-Net as Sun et al. published it, from a PyTorch checkpoint to a folder of weights.

pub mod checkpoint;
pub mod pickle;

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
};

use burn::tensor::Device;
use checkpoint::CheckpointError;
use flow::pwc::PwcConfig;
use flow::pwc::release::{ReleaseError, from_release};
use ops::weights::{DataSource, Manifest, NetRecord, Precision, WeightsError, add_net, file_of, fill, tensors_of};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use sha2::{Digest, Sha256};

/// What the licence is called that nobody stated.
pub const NOT_STATED: &str = "not stated";

/// A checkpoint to import.
#[derive(Clone, Debug)]
pub struct Request {
    /// The checkpoint.
    pub file: PathBuf,
    /// Folder of weights; what lies in it stays.
    pub out: PathBuf,
    /// Names of the net in the folder: the same weights under each.
    pub nets: Vec<String>,
    /// Licence of the checkpoint.
    pub licence: Option<String>,
    /// Replace nets of these names.
    pub force: bool,
}

/// What was imported.
#[derive(Clone, Debug)]
pub struct Imported {
    /// The net's architecture.
    pub architecture: PwcConfig,
    /// The files that were written.
    pub files: Vec<PathBuf>,
}

/// A checkpoint that can't be imported.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// The checkpoint can't be read.
    #[error(transparent)]
    Checkpoint(#[from] CheckpointError),
    /// It isn't the published net.
    #[error("{}: {source}", path.display())]
    Release {
        /// The checkpoint.
        path: PathBuf,
        /// What is different.
        source: ReleaseError,
    },
    /// A name that can't be a flow net's.
    #[error(
        "`{0}` can't be the name of a flow net: expected letters, digits, `-` and `_`, for example adjacent, distant or chairs"
    )]
    Name(String),
    /// There is a net of that name.
    #[error("{} holds a net `{net}` already: choose another with --net, another folder with --out, or replace it with --force", folder.display())]
    Exists {
        /// The folder of weights.
        folder: PathBuf,
        /// The net.
        net: String,
    },
    /// The weights can't be written, or don't fit each other.
    #[error(transparent)]
    Weights(#[from] WeightsError),
}

impl ImportError {
    /// Whether the command was wrong rather than what it met.
    pub fn is_usage(&self) -> bool {
        matches!(self, Self::Name(_) | Self::Exists { .. })
    }
}

/// Imports a checkpoint. Nothing is written unless all of it fits.
///
/// # Errors
/// See [`ImportError`].
pub fn import(request: &Request) -> Result<Imported, ImportError> {
    let Request { file, out, nets, licence, force } = request;
    check_names(out, nets, *force)?;
    let (config, tensors) =
        from_release(checkpoint::read(file)?).map_err(|source| ImportError::Release { path: file.clone(), source })?;
    // Every weight is replaced by the file's.
    let empty = config.init(&Device::flex(), &mut ChaCha8Rng::seed_from_u64(0));
    let net = fill(empty, tensors, file)?;
    let weights = tensors_of(&net);

    let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let bytes = fs::read(file).map_err(|source| CheckpointError::Read { path: file.clone(), source })?;
    let digest: String = Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect();
    let record = NetRecord {
        kind: flow::weights::KIND.into(),
        architecture: serde_json::to_value(&config).expect("numbers and names are JSON"),
        precision: Precision::F32,
        parameters: config.parameters(),
        sha256: None,
        shards: Vec::new(),
        inputs: Vec::new(),
        outputs: Vec::new(),
        training: format!("imported from {name} (SHA-256 {digest}), a checkpoint of PWC-Net as Sun et al. published it"),
        data: vec![DataSource {
            source: format!("the checkpoint {name}"),
            licence: licence.clone().unwrap_or_else(|| NOT_STATED.into()),
            count: 1,
            names: Vec::new(),
        }],
        metrics: BTreeMap::new(),
    };
    for net in nets {
        add_net(out, net, &weights, record.clone(), u64::MAX)?;
    }
    Ok(Imported { architecture: config, files: nets.iter().map(|net| file_of(out, net)).collect() })
}

fn check_names(folder: &Path, nets: &[String], force: bool) -> Result<(), ImportError> {
    let manifest = match Manifest::read(folder) {
        Ok(manifest) => manifest,
        Err(WeightsError::Missing { .. }) => Manifest::default(),
        Err(error) => return Err(error.into()),
    };
    for net in nets {
        let plain = net.chars().all(|c| c.is_ascii_alphanumeric() || c == '-' || c == '_');
        if net.is_empty() || !plain || net == svbrdf::weights::NAME {
            return Err(ImportError::Name(net.clone()));
        }
        if !force && (manifest.nets.contains_key(net) || file_of(folder, net).exists()) {
            return Err(ImportError::Exists { folder: folder.into(), net: net.clone() });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use burn::tensor::{Tensor, TensorData};
    use ops::planes::values;

    fn golden(folder: &str, file: &str) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/flow").join(folder).join(file)
    }

    fn request(folder: &str, out: &Path) -> Request {
        let nets = vec!["adjacent".to_string(), "distant".to_string()];
        Request { file: golden(folder, "pwc_net.pth.tar"), out: out.into(), nets, licence: None, force: false }
    }

    /// 8-bit pictures `[2, 3, 64, 64]` and the flow between them, as the published net's PyTorch twin found it.
    fn case(folder: &str) -> ([Tensor<4>; 2], Vec<f32>) {
        let bytes = fs::read(golden(folder, "case.safetensors")).unwrap();
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let images: Vec<f32> = file.tensor("images").unwrap().data().iter().map(|b| f32::from(*b) / 255.0).collect();
        let flow = file.tensor("flow").unwrap().data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let picture = |half: &[f32]| Tensor::from_data(TensorData::new(half.to_vec(), [1, 3, 64, 64]), &Device::flex());
        let (first, second) = images.split_at(images.len() / 2);
        ([picture(first), picture(second)], flow)
    }

    #[test]
    fn an_imported_checkpoint_finds_the_flow_that_pytorch_finds() {
        for (folder, convs) in [("release", 3), ("release-first-version", 2)] {
            let home = tempfile::tempdir().unwrap();
            let imported = import(&request(folder, home.path())).unwrap();
            assert_eq!(imported.architecture.convs_per_level, convs);
            let ([first, second], expected) = case(folder);
            for net in ["adjacent", "distant"] {
                let (net, record) = flow::weights::load(home.path(), net, &Device::flex()).unwrap();
                assert!(record.training.contains("pwc_net.pth.tar") && record.data[0].licence == NOT_STATED);
                let found = values(net.flow(first.clone(), second.clone()));
                let largest = expected.iter().fold(0.0f32, |l, v| l.max(v.abs()));
                let worst = found.iter().zip(&expected).map(|(f, e)| (f - e).abs()).fold(0.0, f32::max);
                println!("{folder}: {worst} px of {largest}");
                assert!(worst <= 1e-4 * largest, "{folder}: {worst} px of {largest}");
            }
        }
    }

    #[test]
    fn what_is_there_stays_unless_it_is_to_go() {
        let home = tempfile::tempdir().unwrap();
        let request = request("release", home.path());
        import(&request).unwrap();
        assert!(matches!(import(&request), Err(ImportError::Exists { .. })));
        import(&Request { nets: vec!["third".into()], licence: Some("CC0-1.0".into()), ..request.clone() }).unwrap();
        import(&Request { force: true, ..request.clone() }).unwrap();
        let manifest = Manifest::read(home.path()).unwrap();
        assert_eq!(manifest.nets.keys().collect::<Vec<_>>(), ["adjacent", "distant", "third"]);
        assert_eq!(manifest.nets["third"].data[0].licence, "CC0-1.0");
        for name in ["", "svbrdf", "../up", "a b"] {
            let error = import(&Request { nets: vec![name.into()], ..request.clone() }).unwrap_err();
            assert!(matches!(error, ImportError::Name(_)), "{error}");
        }
    }

    #[test]
    fn files_that_are_no_checkpoint_are_named_and_nothing_is_written() {
        let home = tempfile::tempdir().unwrap();
        let file = home.path().join("given.pth");
        let out = home.path().join("weights");
        let refused = |bytes: &[u8]| {
            fs::write(&file, bytes).unwrap();
            let error = import(&Request { file: file.clone(), ..request("release", &out) }).unwrap_err();
            assert!(!out.exists(), "{error}");
            error.to_string()
        };
        let whole = fs::read(golden("release", "pwc_net.pth.tar")).unwrap();
        assert!(refused(&[]).contains("torch.save"));
        assert!(refused(b"\x89PNG\r\n\x1a\n").contains("not a checkpoint"));
        assert!(refused(&whole[..whole.len() / 2]).contains("cut short"));
        let svbrdf = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/golden/svbrdf/paper/svbrdf.safetensors");
        assert!(refused(&fs::read(svbrdf).unwrap()).contains("conv1a.0.weight"));
        let ours = golden("published-sixteenth", "adjacent.safetensors");
        assert!(refused(&fs::read(ours).unwrap()).contains("flow.init"));
        let missing = import(&Request { file: home.path().join("none.pth"), ..request("release", &out) }).unwrap_err();
        assert!(missing.to_string().contains("none.pth"), "{missing}");
    }
}
