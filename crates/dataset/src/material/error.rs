//! What can be wrong with a material.

/// A material that can't be used, and why.
#[derive(Debug, thiserror::Error)]
pub enum MaterialError {
    /// A tile without texels.
    #[error(
        "material {name}: {width}×{height} texels; expected at least 1×1 and a positive number of texels over the material"
    )]
    Size {
        /// Name of the material.
        name: String,
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
    },
    /// NaN or infinity in a map.
    #[error("material {name}: a map holds NaN or infinite values; export it again without them")]
    NonFinite {
        /// Name of the material.
        name: String,
    },
}
