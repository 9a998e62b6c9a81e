//! Arithmetic of directions and positions.

/// a · b.
#[inline(always)]
pub fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a × b.
#[inline(always)]
pub fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// a − b.
#[inline(always)]
pub fn minus(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// s·a.
#[inline(always)]
pub fn scaled(a: [f32; 3], s: f32) -> [f32; 3] {
    [s * a[0], s * a[1], s * a[2]]
}

/// a / |a|; a vector shorter than 1e-15 stays nearly zero instead of becoming NaN.
#[inline(always)]
pub fn unit(a: [f32; 3]) -> [f32; 3] {
    scaled(a, 1.0 / dot(a, a).max(1e-30).sqrt())
}

/// The half vector of two unit vectors, (a + b)/|a + b|; nearly zero for opposite ones.
#[inline(always)]
pub fn half(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    unit([a[0] + b[0], a[1] + b[1], a[2] + b[2]])
}
