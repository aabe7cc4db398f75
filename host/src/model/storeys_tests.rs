//! Models of storeys against what their flexibilities say.

use nalgebra::{DMatrix, DVector};

use super::Structure;
use super::effect::Effect;
use super::layout::LayoutNode;
use super::matrices::ImportedMatrices;

/// Storeys of 3 m on the ground, masses of their floors, along X or Y.
fn frame(stiffness_n_m: &[f64], masses_kg: &[f64], directions: usize) -> Structure {
    let count = masses_kg.len();
    let (mut stiffness, mut mass) = (
        DMatrix::zeros(count * directions, count * directions),
        DMatrix::zeros(count * directions, count * directions),
    );
    for direction in 0..directions {
        let row = |floor: usize| direction * count + floor;
        for (floor, (storey, kg)) in stiffness_n_m.iter().zip(masses_kg).enumerate() {
            mass[(row(floor), row(floor))] = *kg;
            stiffness[(row(floor), row(floor))] += storey;
            if floor > 0 {
                stiffness[(row(floor - 1), row(floor - 1))] += storey;
                stiffness[(row(floor), row(floor - 1))] -= storey;
                stiffness[(row(floor - 1), row(floor))] -= storey;
            }
        }
    }
    let node = |at: usize| LayoutNode {
        name: at.to_string(),
        position_m: [0.0, 0.0, 3.0 * at as f64],
        rows: std::array::from_fn(|dof| {
            at.checked_sub(1).filter(|_| dof < directions).map(|floor| dof * count + floor)
        }),
        fixed: [at == 0; 6],
    };
    let nodes = (0..=count).map(node).collect();
    let places: std::sync::Arc<[String]> = std::sync::Arc::new([]);
    Structure::new(super::Body::Matrices(ImportedMatrices {
        stiffness,
        mass,
        nodes,
        whole: None,
        coordinates: None,
        places,
    }))
}

const MASSES_KG: [f64; 6] = [2e4, 2e4, 1.9e4, 1.8e4, 1.8e4, 1.2e4];
const SHEARS_N_M: [f64; 6] = [9e7, 8e7, 8e7, 7e7, 6e7, 5e7];

fn with(structure: &Structure, word: &str) -> DMatrix<f64> {
    let effect: Effect = word.parse().unwrap();
    structure.clone().and(&[effect]).unwrap().assemble().stiffness
}

fn are_equal(one: &DMatrix<f64>, other: &DMatrix<f64>, to: f64) -> bool {
    (one - other).amax() <= to * other.amax()
}

/// The height of a floor in m.
fn height_m(floor: usize) -> f64 {
    3.0 * (floor + 1) as f64
}

/// Sways of a cantilever of so many floors by a unit force at each, in m/N, integrated in steps of a millimetre.
fn cantilever(floors: usize) -> DMatrix<f64> {
    let bending_n_m2 = 6e10;
    let step_m = 1e-3;
    let sway = |at_m: f64, force_m: f64| {
        let steps = (at_m.min(force_m) / step_m).round() as usize;
        let curvature = |k: usize| (k as f64 + 0.5) * step_m;
        (0..steps).map(curvature).map(|s| (at_m - s) * (force_m - s) * step_m).sum::<f64>() / bending_n_m2
    };
    DMatrix::from_fn(floors, floors, |at, force| sway(height_m(at), height_m(force)))
}

/// Loads in proportion to mass and height.
fn loads(masses_kg: &[f64]) -> DVector<f64> {
    DVector::from_fn(masses_kg.len(), |floor, _| masses_kg[floor] * height_m(floor))
}

/// A frame whose columns get longer and shorter: sway by storeys and by a cantilever. Storey stiffnesses taken from its sway under code loads
/// have both; told the share of bending, the model is the frame.
#[test]
fn what_was_merged_is_taken_apart() {
    let count = MASSES_KG.len();
    let bent = cantilever(count);
    let sheared = |at: usize, force: usize| (0..=at.min(force)).map(|storey| 1.0 / SHEARS_N_M[storey]).sum::<f64>();
    let flexibility = DMatrix::from_fn(count, count, sheared) + &bent;
    let loads = loads(&MASSES_KG);
    let sway = &flexibility * &loads;
    let bends = bent * &loads;
    let merged: Vec<f64> = (0..count)
        .map(|floor| {
            loads.rows(floor, count - floor).sum() / (sway[floor] - if floor > 0 { sway[floor - 1] } else { 0.0 })
        })
        .collect();
    let table = frame(&merged, &MASSES_KG, 1);
    let share = bends[count - 1] / sway[count - 1];
    assert!((0.1..0.5).contains(&share), "{share}");
    let found = with(&table, &format!("overall-bending={share}"));
    assert!(are_equal(&found, &flexibility.clone().try_inverse().unwrap(), 1e-6));
    // The sway stays; frequencies but the first rise.
    let stays = found.clone().cholesky().unwrap().solve(&loads);
    assert!((stays - &sway).amax() < 1e-9 * sway.amax());
    let modes = |structure: &Structure| structure.assemble().modes().unwrap().frequency_hz;
    let effect: Effect = format!("overall-bending={share}").parse().unwrap();
    let (before, after) = (modes(&table), modes(&table.clone().and(&[effect]).unwrap()));
    let raised: Vec<f64> = (0..3).map(|mode| after[mode] / before[mode] - 1.0).collect();
    assert!(raised[0].abs() < 0.01 && raised[1] > 0.02 && raised[2] > raised[1], "{raised:?}");
}

/// The same frame, but for the bending left out of its storeys: added to them as they are, the model is the frame, and its first frequency
/// falls most.
#[test]
fn what_was_left_out_is_added() {
    let count = MASSES_KG.len();
    let line = frame(&SHEARS_N_M, &MASSES_KG, 1);
    let sheared = line.assemble().stiffness.try_inverse().unwrap();
    let bent = cantilever(count);
    let loads = loads(&MASSES_KG);
    let top = |flexibility: &DMatrix<f64>| (flexibility * &loads)[count - 1];
    let ratio = top(&bent) / top(&sheared);
    let word = format!("chord-drift={ratio}");
    let effect: Effect = word.parse().unwrap();
    let found = with(&line, &word);
    assert!(are_equal(&found, &(sheared + bent).try_inverse().unwrap(), 1e-6));
    let modes = |structure: &Structure| structure.assemble().modes().unwrap().frequency_hz;
    let (before, after) = (modes(&line), modes(&line.clone().and(&[effect]).unwrap()));
    let fallen: Vec<f64> = (0..3).map(|mode| 1.0 - after[mode] / before[mode]).collect();
    assert!(fallen[0] > 0.02 && fallen.windows(2).all(|pair| pair[1] < pair[0]), "{fallen:?}");
}

/// Of the two topmost storeys' drift, half of the top's sway as bending would be 79 and 153 %: by hand from the moments of loads m z.
#[test]
fn storeys_that_are_held_at_their_limit_are_told() {
    let line = frame(&SHEARS_N_M, &MASSES_KG, 1);
    let plan = frame(&SHEARS_N_M, &MASSES_KG, 2);
    let caution = |structure: &Structure, word: &str| word.parse::<Effect>().unwrap().caution(structure);
    for word in ["overall-bending=0.25", "chord-drift=2"] {
        assert_eq!(caution(&line, word), None);
    }
    assert!(caution(&line, "overall-bending=0.5").unwrap().contains("the storeys below 18.0 m (along X) would"));
    assert!(
        caution(&line, "overall-bending=0.8").unwrap().contains("the storeys below 12.0, 15.0, 18.0 m (along X) would")
    );
    let along_y = caution(&plan, "overall-bending=share_x=0.1,share_y=0.5").unwrap();
    assert!(along_y.contains("the storeys below 18.0 m (along Y) would"), "{along_y}");
}

/// A floor without mass on top: its storey has no drift under the loads, and bends along.
#[test]
fn a_floor_without_mass_bends_along() {
    let (mut stiffness, mut masses) = (SHEARS_N_M.to_vec(), MASSES_KG.to_vec());
    stiffness.push(4e7);
    masses.push(0.0);
    let topped = frame(&stiffness, &masses, 1);
    let count = masses.len();
    let sheared = topped.assemble().stiffness.try_inverse().unwrap();
    let bent = cantilever(count);
    let loads = loads(&masses);
    let top = |flexibility: &DMatrix<f64>| (flexibility * &loads)[count - 1];
    let expected = (&sheared + &bent * (0.2 * top(&sheared) / top(&bent))).try_inverse().unwrap();
    assert!(are_equal(&with(&topped, "chord-drift=0.2"), &expected, 1e-6));
    let told = "overall-bending=0.2".parse::<Effect>().unwrap();
    assert!(told.caution(&topped).is_none());
    // The sway under the loads stays up to the topmost mass.
    let merged = with(&topped, "overall-bending=0.2").try_inverse().unwrap();
    let highest_mass = |flexibility: &DMatrix<f64>| (flexibility * &loads)[count - 2];
    assert!((highest_mass(&merged) / highest_mass(&sheared) - 1.0).abs() < 1e-9);
    assert!(!are_equal(&merged, &sheared, 1e-3));
}

#[test]
fn each_direction_bends_by_itself() {
    let plan = frame(&SHEARS_N_M, &MASSES_KG, 2);
    let line = frame(&SHEARS_N_M, &MASSES_KG, 1);
    let (apart, along_y) = (with(&plan, "overall-bending=share_x=0.1,share_y=0.2"), with(&line, "overall-bending=0.2"));
    let count = MASSES_KG.len();
    assert!(are_equal(&apart.view((count, count), (count, count)).into_owned(), &along_y, 1e-12));
    assert!(are_equal(&apart.view((0, 0), (count, count)).into_owned(), &with(&line, "overall-bending=0.1"), 1e-12));
    // A line has one direction, and no value for another.
    assert!(line.clone().and(&["chord-drift=ratio_x=0.1,ratio_y=0.2".parse().unwrap()]).is_err());
    assert!(plan.clone().and(&["chord-drift=ratio_x=0.1,ratio_y=0.2".parse().unwrap()]).is_ok());
    assert_eq!(apart.view((0, count), (count, count)).amax(), 0.0);
}

/// The ground gives: flexibilities add, whatever stands on it, and a rotation sways a floor by its height.
#[test]
fn a_base_that_gives_adds_its_flexibility() {
    let line = frame(&SHEARS_N_M, &MASSES_KG, 1);
    let clamped = line.assemble().stiffness.try_inverse().unwrap();
    for (word, by) in [("base-rotation=3e-11", 3e-11), ("base-translation=5e-9", 0.0)] {
        let found = with(&line, word).try_inverse().unwrap();
        let more =
            if by > 0.0 { |by: f64, at: f64, force: f64| by * at * force } else { |_: f64, _: f64, _: f64| 5e-9 };
        let expected = DMatrix::from_fn(clamped.nrows(), clamped.ncols(), |at, force| {
            clamped[(at, force)] + more(by, height_m(at), height_m(force))
        });
        assert!(are_equal(&found, &expected, 1e-9), "{word}");
    }
    // A sensor on the ground sees it turn: θ = C F z under a force at the top.
    let effect: Effect = "base-rotation=3e-11".parse().unwrap();
    let assembly = line.clone().and(&[effect]).unwrap().assemble();
    let force = DVector::from_fn(assembly.dofs(), |row, _| if row + 1 == assembly.dofs() { 1e5 } else { 0.0 });
    let sway = assembly.stiffness.clone().cholesky().unwrap().solve(&force);
    let at_ground = assembly.axis_motion(0.0) * &sway;
    assert!((at_ground[3] / (3e-11 * 1e5 * height_m(5)) - 1.0).abs() < 1e-9, "{at_ground}");
    assert!(at_ground[0].abs() < 1e-12);
    let slides: Effect = "base-translation=5e-9".parse().unwrap();
    let assembly = line.and(&[slides]).unwrap().assemble();
    let sway = assembly.stiffness.clone().cholesky().unwrap().solve(&force);
    assert!(((assembly.axis_motion(0.0) * &sway)[0] / (5e-9 * 1e5) - 1.0).abs() < 1e-9);
}

/// One floor on one storey is a pendulum on its head: k - m g / h; weight adds up downwards.
#[test]
fn the_weight_above_leans_on_storeys() {
    let line = frame(&SHEARS_N_M, &MASSES_KG, 1);
    let change = line.assemble().stiffness - with(&line, "p-delta=1");
    let weight_n = |from: usize| 9.80665 * MASSES_KG[from..].iter().sum::<f64>();
    let expected =
        frame(&std::array::from_fn::<f64, 6, _>(|storey| weight_n(storey) / 3.0), &MASSES_KG, 1).assemble().stiffness;
    assert!(are_equal(&change, &expected, 1e-9));
}

/// Effects of storeys say in which order they were typed nothing.
#[test]
fn the_order_of_effects_of_storeys_does_not_matter() {
    let line = frame(&SHEARS_N_M, &MASSES_KG, 1);
    let words = ["overall-bending=0.15", "p-delta=0.8", "base-rotation=3e-11"];
    let effects: Vec<Effect> = words.iter().map(|word| word.parse().unwrap()).collect();
    let one = line.clone().and(&effects).unwrap().assemble().stiffness;
    let other = line.and(&effects.into_iter().rev().collect::<Vec<_>>()).unwrap().assemble().stiffness;
    assert!(are_equal(&one, &other, 1e-12));
}

#[test]
fn what_is_no_model_of_storeys_is_told_so() {
    let error =
        |structure: &Structure, word: &str| structure.clone().and(&[word.parse().unwrap()]).unwrap_err().to_string();
    let mut braced = frame(&SHEARS_N_M, &MASSES_KG, 1);
    if let super::Body::Matrices(matrices) = &mut braced.body {
        // A brace over two storeys.
        for (row, column, sign) in [(1, 1, 1.0), (3, 3, 1.0), (1, 3, -1.0), (3, 1, -1.0)] {
            matrices.stiffness[(row, column)] += sign * 1e7;
        }
    }
    for word in ["overall-bending=0.1", "p-delta=1"] {
        assert!(error(&braced, word).contains("nothing but the next floors' shear"), "{}", error(&braced, word));
    }
    assert!(error(&braced, "outrigger@6m=1e9").contains("no rows for rotations"));
    // It still stands on its base; one that is held higher up as well does not.
    assert!(braced.clone().and(&["base-rotation=1e-11".parse().unwrap()]).is_ok());
    if let super::Body::Matrices(matrices) = &mut braced.body {
        matrices.stiffness[(4, 4)] += 1e6;
    }
    assert!(error(&braced, "base-rotation=1e-11").contains("tied to the ground"));
    if let super::Body::Matrices(matrices) = &mut braced.body {
        matrices.nodes.clear();
    }
    for word in ["overall-bending=0.1", "base-translation=1e-9"] {
        assert!(error(&braced, word).contains("needs a base") || error(&braced, word).contains("a model of storeys"));
    }
}

/// Matrices as programs write them, with five digits, are the same model.
#[test]
fn a_few_digits_are_enough() {
    let mut line = frame(&SHEARS_N_M.map(|stiffness| stiffness * 1.234_567_8), &MASSES_KG, 1);
    if let super::Body::Matrices(matrices) = &mut line.body {
        matrices.stiffness.apply(|entry| *entry = format!("{entry:.4e}").parse().unwrap());
    }
    for word in ["base-rotation=1e-11", "base-translation=1e-9", "overall-bending=0.1", "p-delta=1"] {
        assert!(line.clone().and(&[word.parse().unwrap()]).is_ok(), "{word}");
    }
}

/// Heights may be above any level, and the ground may be left out: storeys of 3 m stand where they stand.
#[test]
fn heights_are_above_the_ground_whatever_they_are_measured_from() {
    let line = frame(&SHEARS_N_M, &MASSES_KG, 1);
    let moved = |by_m: f64, has_ground: bool| {
        let mut moved = line.clone();
        if let super::Body::Matrices(matrices) = &mut moved.body {
            matrices.nodes.iter_mut().for_each(|node| node.position_m[2] += by_m);
            matrices.nodes.drain(..usize::from(!has_ground));
        }
        moved
    };
    for word in ["overall-bending=0.1", "base-rotation=3e-11", "p-delta=1"] {
        let expected = with(&line, word);
        for (by_m, has_ground) in [(0.0, false), (100.0, true), (100.0, false), (-3.0, false), (-20.0, false)] {
            assert!(are_equal(&with(&moved(by_m, has_ground), word), &expected, 1e-9), "{word}, {by_m}, {has_ground}");
        }
    }
}
