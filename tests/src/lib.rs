//! Acceptance tests of the whole workspace live in this crate's test targets.
