//! Materials made by functions of a seed.
