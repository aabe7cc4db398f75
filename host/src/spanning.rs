//! Lines between places where nobody says which belong together: the shortest that join all of them (Prim 1957).

/// Pairs of places, by their positions in the list, lower first; one fewer than there are places.
pub(crate) fn shortest_lines(places_m: &[[f64; 3]]) -> Vec<[usize; 2]> {
    let Some(first) = places_m.first() else { return Vec::new() };
    // Of each place that is not joined yet, the nearest that is, and how far that is.
    let mut waiting: Vec<(usize, usize, f64)> =
        places_m.iter().enumerate().skip(1).map(|(at, place_m)| (at, 0, distance_m(*place_m, *first))).collect();
    let mut lines = Vec::with_capacity(waiting.len());
    while let Some(next) = (0..waiting.len()).min_by(|&a, &b| waiting[a].2.total_cmp(&waiting[b].2)) {
        let (at, nearest, _) = waiting.swap_remove(next);
        lines.push([at.min(nearest), at.max(nearest)]);
        for (other, nearest, nearest_m) in &mut waiting {
            let from_here_m = distance_m(places_m[*other], places_m[at]);
            if from_here_m < *nearest_m {
                (*nearest, *nearest_m) = (at, from_here_m);
            }
        }
    }
    lines.sort_unstable();
    lines
}

fn distance_m(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

#[cfg(test)]
mod tests {
    use super::shortest_lines;

    #[test]
    fn a_mast_is_joined_upwards_and_a_fork_at_its_corner() {
        let mast = [30.0, 10.0, 20.0, 40.0].map(|z| [0.0, 0.0, z]);
        assert_eq!(shortest_lines(&mast), [[0, 2], [0, 3], [1, 2]]);
        let fork = [[0.0; 3], [0.0, 0.0, 5.0], [4.0, 0.0, 5.0], [-4.0, 0.0, 5.0]];
        assert_eq!(shortest_lines(&fork), [[0, 1], [1, 2], [1, 3]]);
        assert!(shortest_lines(&[]).is_empty() && shortest_lines(&fork[..1]).is_empty());
    }
}
