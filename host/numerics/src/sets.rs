//! What hangs together, by which pairs are joined.

/// Numbers below `count` in sets between which no two are joined, each set ascending; `is_joined` is asked with the larger number first.
pub fn sets_apart(count: usize, is_joined: impl Fn(usize, usize) -> bool) -> Vec<Vec<usize>> {
    // The lowest number that each is known to hang together with.
    let mut lowest: Vec<usize> = (0..count).collect();
    for low in 0..count {
        for high in low + 1..count {
            if lowest[high] != lowest[low] && is_joined(high, low) {
                let (kept, gone) = (lowest[high].min(lowest[low]), lowest[high].max(lowest[low]));
                lowest.iter_mut().filter(|of| **of == gone).for_each(|of| *of = kept);
            }
        }
    }
    let members = |first: usize| (first..count).filter(|&at| lowest[at] == first).collect();
    (0..count).filter(|&at| lowest[at] == at).map(members).collect()
}
