//! This process and the operating system: how memory is held, and what is known about it for logs and benchmarks.

/// Keeps freed memory for the next tensor instead of giving it back to the system; a program calls it first of all.
///
/// The nets free and allocate the same large tensors in every step. GNU's allocator asks the system for each of them anew, and
/// the system hands out zeroed pages one by one: a quarter of a training step. Kept memory is used again piece by piece and
/// joined when neighbours are free, so the most that is held grows little. Does nothing with other allocators.
pub fn keep_memory() {
    #[cfg(target_env = "gnu")]
    // SAFETY: both are documented settings of the allocator, which takes its lock to change them.
    unsafe {
        libc::mallopt(libc::M_MMAP_MAX, 0);
        libc::mallopt(libc::M_TRIM_THRESHOLD, -1);
    }
}

/// Memory in MiB that the process holds now; `None` where the system has no /proc.
pub fn rss_mib() -> Option<f64> {
    status_kib("VmRSS:").map(|kib| kib / 1024.0)
}

/// The most memory in MiB that the process ever held.
pub fn peak_rss_mib() -> Option<f64> {
    status_kib("VmHWM:").map(|kib| kib / 1024.0)
}

fn status_kib(name: &str) -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix(name))?.split_whitespace().next()?.parse().ok()
}
