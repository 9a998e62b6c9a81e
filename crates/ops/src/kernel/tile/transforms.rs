//! Winograd's transforms.

/// Winograd's transforms of F(4×4, 3×3) for one kind of vector (Lavin and Gray 2016, section 4.3, with other points).
macro_rules! winograd_transforms {
    (
        [$(#[$features:meta])*], $vector:ident, $zero:expr, $splat:ident, $load:ident, $store:ident, $tiles:path, $rows:path,
        |$sum:ident, $a:ident, $b:ident| $multiply_add:expr
    ) => {
        const A: f32 = super::POINTS[0];
        const B: f32 = super::POINTS[1];

        /// `sum + factor · b`
        // A number's own operations are safe, a vector's are not.
        #[allow(unused_unsafe)]
        #[inline]
        $(#[$features])*
        unsafe fn plus(sum: $vector, factor: f32, $b: $vector) -> $vector {
            // SAFETY: the module's features are there.
            unsafe {
                let $a = $splat(factor);
                let $sum = &mut { sum };
                $multiply_add
            }
        }

        /// Frequencies of six pixels in a row.
        #[inline]
        $(#[$features])*
        unsafe fn spread_row([a, b, c, d, e, f]: [$vector; 6]) -> [$vector; 6] {
            // SAFETY: the module's features are there.
            unsafe {
                let (near_even, near_odd) = (plus(e, -B * B, c), plus(d, -B * B, b));
                let (far_even, far_odd) = (plus(e, -A * A, c), plus(d, -A * A, b));
                [
                    plus(plus(e, -(A * A + B * B), c), A * A * B * B, a),
                    plus(near_even, A, near_odd),
                    plus(near_even, -A, near_odd),
                    plus(far_even, B, far_odd),
                    plus(far_even, -B, far_odd),
                    plus(plus(f, -(A * A + B * B), d), A * A * B * B, b),
                ]
            }
        }

        /// Four results in a row from the sums of their frequencies.
        #[inline]
        $(#[$features])*
        unsafe fn gather_row([a, b, c, d, e, f]: [$vector; 6]) -> [$vector; 4] {
            // SAFETY: the module's features are there.
            unsafe {
                let (near, far) = (plus(b, 1.0, c), plus(d, 1.0, e));
                let (step, leap) = (plus(b, -1.0, c), plus(d, -1.0, e));
                [
                    plus(plus(a, 1.0, near), 1.0, far),
                    plus(plus($zero, A, step), B, leap),
                    plus(plus($zero, A * A, near), B * B, far),
                    plus(plus(f, A * A * A, step), B * B * B, leap),
                ]
            }
        }

        /// # Safety
        /// Needs the module's features, a whole window, and stores as `Instructions::spread` has them.
        $(#[$features])*
        pub unsafe fn spread(pixels: *const f32, to: *mut f32, step: usize) {
            // SAFETY: the caller's promise.
            unsafe {
                for i in (0..TILE).step_by(LANES) {
                    let mut lines = [[$zero; 6]; 6];
                    for (y, line) in lines.iter_mut().enumerate() {
                        *line = spread_row($tiles(pixels.add(y * Window::WIDTH + Window::SECOND + 4 * i)));
                    }
                    for u in 0..6 {
                        let column = [lines[0][u], lines[1][u], lines[2][u], lines[3][u], lines[4][u], lines[5][u]];
                        for (v, frequency) in spread_row(column).into_iter().enumerate() {
                            $store(to.add((v * 6 + u) * step + i), frequency);
                        }
                    }
                }
            }
        }

        /// The gradient of [`gather_row`].
        #[inline]
        $(#[$features])*
        unsafe fn spread_results_row([a, b, c, d]: [$vector; 4]) -> [$vector; 6] {
            // SAFETY: the module's features are there.
            unsafe {
                let (near_even, near_odd) = (plus(a, A * A, c), plus(b, A * A, d));
                let (far_even, far_odd) = (plus(a, B * B, c), plus(b, B * B, d));
                [
                    a,
                    plus(near_even, A, near_odd),
                    plus(near_even, -A, near_odd),
                    plus(far_even, B, far_odd),
                    plus(far_even, -B, far_odd),
                    d,
                ]
            }
        }

        /// # Safety
        /// Needs the module's features, and loads and stores as `Instructions::spread_results` has them.
        $(#[$features])*
        pub unsafe fn spread_results(results: *const f32, to: *mut f32, step: usize) {
            // SAFETY: the caller's promise.
            unsafe {
                for i in (0..TILE).step_by(LANES) {
                    let mut lines = [[$zero; 6]; 4];
                    for (y, line) in lines.iter_mut().enumerate() {
                        let mut row = [$zero; 4];
                        for (x, result) in row.iter_mut().enumerate() {
                            *result = $load(results.add((y * 4 + x) * TILE + i));
                        }
                        *line = spread_results_row(row);
                    }
                    for u in 0..6 {
                        let column = [lines[0][u], lines[1][u], lines[2][u], lines[3][u]];
                        for (v, frequency) in spread_results_row(column).into_iter().enumerate() {
                            $store(to.add((v * 6 + u) * step + i), frequency);
                        }
                    }
                }
            }
        }

        /// # Safety
        /// Needs the module's features, and loads and stores as `Instructions::gather` has them.
        $(#[$features])*
        pub unsafe fn gather(sums: *const f32, step: usize, to: *mut f32) {
            // SAFETY: the caller's promise.
            unsafe {
                for i in (0..TILE).step_by(LANES) {
                    let mut lines = [[$zero; 6]; 4];
                    for u in 0..6 {
                        let mut column = [$zero; 6];
                        for (v, frequency) in column.iter_mut().enumerate() {
                            *frequency = $load(sums.add((v * 6 + u) * step + i));
                        }
                        for (line, result) in lines.iter_mut().zip(gather_row(column)) {
                            line[u] = result;
                        }
                    }
                    for (y, line) in lines.into_iter().enumerate() {
                        for (x, results) in $rows(gather_row(line)).into_iter().enumerate() {
                            $store(to.add((y * TILE + i) * 4 + x * LANES), results);
                        }
                    }
                }
            }
        }
    };
}

pub(super) use winograd_transforms;
