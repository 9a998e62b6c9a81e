//! The two inner loops of every convolution pass, compiled once for AVX2+FMA and once for any processor.
//!
//! Both read *rows of pixels*: for each of `K` taps (an input channel at one kernel offset) a run of consecutive pixels at
//! `base + offsets[k]`. Vectors run along the pixels, so no layout change is needed anywhere.

/// Pixels per register tile.
pub const TILE: usize = 16;
/// Lanes of one vector.
pub const LANES: usize = 8;
/// Most output channels of a register tile: 6 × 16 accumulators fill twelve of sixteen AVX registers.
pub const MOST_OUTPUTS: usize = 6;
/// Output channels and taps of a weight-gradient tile.
pub const DOT: usize = 3;

#[inline(always)]
fn fused<const FMA: bool>(a: f32, b: f32, c: f32) -> f32 {
    // Without the instruction, `mul_add` is a slow library call.
    if FMA { a.mul_add(b, c) } else { a * b + c }
}

/// Accumulators of a tile: `outputs × TILE`.
pub type Accumulators = [[f32; TILE]; MOST_OUTPUTS];

/// `acc[r][p] = Σ_k weights[k · R + r] · source[base + offsets[k] + p]`
#[inline(always)]
fn correlate_body<const R: usize, const FMA: bool>(
    source: &[f32],
    base: usize,
    offsets: &[usize],
    weights: &[f32],
    out: &mut Accumulators,
) {
    let mut acc = [[0.0f32; TILE]; R];
    for (&offset, w) in offsets.iter().zip(weights.chunks_exact(R)) {
        let x: &[f32; TILE] = source[base + offset..][..TILE].try_into().expect("a tile of pixels");
        for r in 0..R {
            for p in 0..TILE {
                acc[r][p] = fused::<FMA>(w[r], x[p], acc[r][p]);
            }
        }
    }
    out[..R].copy_from_slice(&acc);
}

/// `acc[i][j][l] += Σ_p gradient_i[p] · x_j[p]` over `length` pixels, lane by lane.
#[inline(always)]
fn dot_body<const R: usize, const FMA: bool>(gradient: [&[f32]; DOT], x: [&[f32]; DOT], acc: &mut [[[f32; LANES]; DOT]; DOT]) {
    let length = gradient[0].len();
    let whole = length / LANES * LANES;
    let mut sum = *acc;
    for p in (0..whole).step_by(LANES) {
        for i in 0..R {
            let g: &[f32; LANES] = gradient[i][p..p + LANES].try_into().expect("lanes");
            for j in 0..DOT {
                let v: &[f32; LANES] = x[j][p..p + LANES].try_into().expect("lanes");
                for l in 0..LANES {
                    sum[i][j][l] = fused::<FMA>(g[l], v[l], sum[i][j][l]);
                }
            }
        }
    }
    for p in whole..length {
        for i in 0..R {
            for j in 0..DOT {
                sum[i][j][p - whole] = fused::<FMA>(gradient[i][p], x[j][p], sum[i][j][p - whole]);
            }
        }
    }
    *acc = sum;
}

macro_rules! by_count {
    ($count:expr, $body:ident, $fma:literal, $($arg:expr),*) => {
        match $count {
            1 => $body::<1, $fma>($($arg),*),
            2 => $body::<2, $fma>($($arg),*),
            3 => $body::<3, $fma>($($arg),*),
            4 => $body::<4, $fma>($($arg),*),
            5 => $body::<5, $fma>($($arg),*),
            _ => $body::<6, $fma>($($arg),*),
        }
    };
}

macro_rules! by_rows {
    ($count:expr, $fma:literal, $($arg:expr),*) => {
        match $count {
            1 => dot_body::<1, $fma>($($arg),*),
            2 => dot_body::<2, $fma>($($arg),*),
            _ => dot_body::<3, $fma>($($arg),*),
        }
    };
}

/// Which instructions a kernel may use; found once per process.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Instructions {
    /// x86-64 with AVX2 and FMA.
    Avx2,
    /// Whatever the compiler's baseline offers.
    Portable,
}

impl Instructions {
    /// The best this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
            return Self::Avx2;
        }
        Self::Portable
    }

    /// Runs the correlation tile for `outputs` (1 to 6) output channels.
    #[inline]
    pub fn correlate(
        self,
        outputs: usize,
        source: &[f32],
        base: usize,
        offsets: &[usize],
        weights: &[f32],
        out: &mut Accumulators,
    ) {
        match self {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Avx2` is only made by `detect` after both features were found.
            Self::Avx2 => unsafe { correlate_avx2(outputs, source, base, offsets, weights, out) },
            _ => by_count!(outputs, correlate_body, false, source, base, offsets, weights, out),
        }
    }

    /// Runs the dot-product tile for `rows` (1 to 3) output channels.
    #[inline]
    pub fn dot(self, rows: usize, gradient: [&[f32]; DOT], x: [&[f32]; DOT], acc: &mut [[[f32; LANES]; DOT]; DOT]) {
        match self {
            #[cfg(target_arch = "x86_64")]
            // SAFETY: `Avx2` is only made by `detect` after both features were found.
            Self::Avx2 => unsafe { dot_avx2(rows, gradient, x, acc) },
            _ => by_rows!(rows, false, gradient, x, acc),
        }
    }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn correlate_avx2(outputs: usize, source: &[f32], base: usize, offsets: &[usize], weights: &[f32], out: &mut Accumulators) {
    by_count!(outputs, correlate_body, true, source, base, offsets, weights, out);
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn dot_avx2(rows: usize, gradient: [&[f32]; DOT], x: [&[f32]; DOT], acc: &mut [[[f32; LANES]; DOT]; DOT]) {
    by_rows!(rows, true, gradient, x, acc);
}
