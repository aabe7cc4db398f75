//! Which worker has which structures: each structure goes to the living worker that it ranks highest ("highest random weight", Thaler and
//! Ravishankar 1998, "Using name-based mappings to increase hit rates"). All workers come to the same without a word, and one that comes or
//! goes moves its own share alone.

use crate::hash;

/// Whether this worker has a structure, among those that are alive.
pub(super) fn is_own<'a>(me: &str, structure: &str, alive: impl IntoIterator<Item = &'a str>) -> bool {
    let own = weight(me, structure);
    alive.into_iter().all(|other| other == me || weight(other, structure) < own)
}

/// FNV-1a of both names, its bits mixed as SplitMix64 does.
fn weight(worker: &str, structure: &str) -> u64 {
    let mut mixed = hash::fnv1a(hash::START, worker.bytes().chain([0]).chain(structure.bytes()));
    mixed = (mixed ^ (mixed >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    mixed = (mixed ^ (mixed >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    mixed ^ (mixed >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_structure_has_one_worker_shares_are_alike_and_one_that_goes_moves_its_own_alone() {
        let workers = ["a1", "b2", "c3", "d4"];
        let structures: Vec<String> = (0..4000).map(|number| format!("tower-{number}")).collect();
        let owner = |structure: &str, alive: &[&'static str]| {
            let own: Vec<&str> =
                alive.iter().copied().filter(|me| is_own(me, structure, alive.iter().copied())).collect();
            assert_eq!(own.len(), 1, "{structure}");
            own[0]
        };
        for worker in workers {
            // Binomial: 1000 with a deviation of 27.
            let share = structures.iter().filter(|structure| owner(structure, &workers) == worker).count();
            assert!((890..1110).contains(&share), "{worker}: {share}");
        }
        for structure in &structures {
            let before = owner(structure, &workers);
            assert!(before == "d4" || owner(structure, &workers[..3]) == before);
        }
    }
}
