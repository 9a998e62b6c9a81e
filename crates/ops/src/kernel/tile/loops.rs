//! Correlation, outer products and chains of multiply-adds.

/// The loops for one kind of vector. `$outputs` counts the output channels of a tile up to the most.
macro_rules! vector_loops {
    (
        $features:tt, $vector:ident, $lanes:literal, $most:literal, [$($outputs:literal)*], $taps:literal,
        $zero:expr, $splat:ident, $load:ident, $store:ident, $tiles:ident, $rows:ident,
        |$sum:ident, $a:ident, $b:ident| $multiply_add:expr
    ) => {
        const LANES: usize = $lanes;
        const VECTORS: usize = TILE / LANES;
        pub const MOST_OUTPUTS: usize = $most;
        pub const TAPS: usize = $taps;

        /// # Safety
        /// Needs the module's features, `base + offset + TILE <= source.len()` for every offset, and `outputs` rows of `out` and
        /// weights per offset, 1 to [`MOST_OUTPUTS`].
        #[target_feature(enable = $features)]
        pub unsafe fn correlate(
            outputs: usize,
            source: &[f32],
            base: usize,
            offsets: &[usize],
            weights: &[f32],
            out: &mut [[f32; TILE]],
        ) {
            // SAFETY: the caller's promise is passed on.
            unsafe {
                match outputs {
                    $($outputs => correlate_outputs::<$outputs>(source, base, offsets, weights, out),)*
                    _ => unreachable!("more outputs than a tile has"),
                }
            }
        }

        #[inline]
        #[target_feature(enable = $features)]
        unsafe fn correlate_outputs<const R: usize>(
            source: &[f32],
            base: usize,
            offsets: &[usize],
            weights: &[f32],
            out: &mut [[f32; TILE]],
        ) {
            // SAFETY: `correlate`'s promise covers every load and the `R` whole rows of `out`.
            unsafe {
                let start = source.as_ptr().add(base);
                let mut weight = weights.as_ptr();
                let mut acc: [[$vector; VECTORS]; R] = [[$zero; VECTORS]; R];
                for &offset in offsets {
                    let mut x = [$zero; VECTORS];
                    for (i, x) in x.iter_mut().enumerate() {
                        *x = $load(start.add(offset + i * LANES));
                    }
                    for (r, acc) in acc.iter_mut().enumerate() {
                        let $a = $splat(*weight.add(r));
                        for ($sum, &$b) in acc.iter_mut().zip(&x) {
                            *$sum = $multiply_add;
                        }
                    }
                    weight = weight.add(R);
                }
                add_rows(out, acc);
            }
        }

        /// Adds sums to sums: over thousands of terms, one running sum would lose digits.
        #[inline]
        #[target_feature(enable = $features)]
        unsafe fn add_rows<const R: usize>(sums: &mut [Outputs], acc: [[$vector; VECTORS]; R]) {
            // SAFETY: the module's features are there; rows are whole.
            unsafe {
                let $a = $splat(1.0);
                for (sums, acc) in sums.iter_mut().zip(acc) {
                    for (i, $b) in acc.into_iter().enumerate() {
                        let to = sums.as_mut_ptr().add(i * LANES);
                        let $sum = &mut $load(to);
                        $store(to, $multiply_add);
                    }
                }
            }
        }

        /// # Safety
        /// Needs the module's features, [`TAPS`] offsets and sums, `length` pixels of the gradient per line, and
        /// `offset + line + length <= source.len()` for all of them.
        #[target_feature(enable = $features)]
        pub unsafe fn outer(
            source: &[f32],
            offsets: &[usize],
            lines: &[usize],
            length: usize,
            gradient: &[Outputs],
            sums: &mut [Outputs],
        ) {
            // SAFETY: the caller's promise covers every load and store.
            unsafe {
                let mut acc: [[$vector; VECTORS]; TAPS] = [[$zero; VECTORS]; TAPS];
                for (&line, gradient) in lines.iter().zip(gradient.chunks_exact(length)) {
                    let mut x = [source.as_ptr(); TAPS];
                    for (x, offset) in x.iter_mut().zip(offsets) {
                        *x = x.add(line + offset);
                    }
                    for (p, gradient) in gradient.iter().enumerate() {
                        let mut g = [$zero; VECTORS];
                        for (i, g) in g.iter_mut().enumerate() {
                            *g = $load(gradient.as_ptr().add(i * LANES));
                        }
                        for (x, acc) in x.iter().zip(&mut acc) {
                            let $a = $splat(*x.add(p));
                            for ($sum, &$b) in acc.iter_mut().zip(&g) {
                                *$sum = $multiply_add;
                            }
                        }
                    }
                }
                add_rows(sums, acc);
            }
        }

        winograd_transforms!([#[target_feature(enable = $features)]], $vector, $zero, $splat, $load, $store, $tiles, $rows, |$sum, $a, $b| $multiply_add);

        /// # Safety
        /// Needs the module's features.
        #[target_feature(enable = $features)]
        pub unsafe fn multiply_adds(factor: f32, rounds: usize) -> (f32, usize) {
            // SAFETY: the caller's promise; stores go to whole rows of `lanes`.
            unsafe {
                let ($a, half) = ($splat(factor), $splat(0.5));
                let mut chains = [half; CHAINS];
                for (i, chain) in chains.iter_mut().enumerate() {
                    // Equal chains would be computed once.
                    *chain = $splat(i as f32);
                }
                for _ in 0..rounds {
                    for chain in &mut chains {
                        let ($sum, $b) = (&mut { half }, *chain);
                        *chain = $multiply_add;
                    }
                }
                let mut lanes = [[0.0f32; LANES]; CHAINS];
                for (to, chain) in lanes.iter_mut().zip(chains) {
                    $store(to.as_mut_ptr(), chain);
                }
                (lanes.as_flattened().iter().sum(), 2 * LANES * CHAINS)
            }
        }
    };
}

pub(super) use vector_loops;
