//! CPU kernels behind the one extension of burn's back ends.
