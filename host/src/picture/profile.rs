//! Stiffness and mass over the height, as fitted: a panel a quantity, bands of one standard deviation over the tolerance.

use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::canvas::{
    Area, Dashes, DrawResult, FRAME, GIVEN, INK, PictureError, Plane, REJECTED, WITH_EFFECTS, picture, width_of,
};
use crate::diagnose::steps::Profiles;
use crate::diagnose::{Profile, ProfileGroup, ProfileSegment, Quantity, QuantityProfile};

const PANEL: (u32, u32) = (190, 430);
const HEADER: u32 = 58;
/// Of groups.
const ROW: u32 = 24;
const AROUND_ROWS: u32 = 52;
/// How strong the tolerance is drawn, which the study states before anything is measured.
const TOLERANCE: f64 = 0.18;
/// The scale is that of the widest band, and at least this in percent.
const LEAST_PERCENT: f64 = 1.0;
/// Segments that are this share of all in length, and further off than the others reach by this factor, go beyond the scale.
const SHORT: f64 = 0.05;
const FAR: f64 = 3.0;

/// One of the lines of a panel.
struct Band<'a> {
    profile: &'a Profile,
    label: &'static str,
    color: RGBColor,
    is_dashed: bool,
}

/// Draws the changes in percent of the table, all panels to one scale: grey is the tolerance, a dashed line the model as first given, a
/// full line the model with its effects, each with its band.
///
/// # Errors
/// When drawing fails.
pub fn profile(structure: &str, profiles: &Profiles) -> Result<String, PictureError> {
    let present = profiles.present();
    let color = if profiles.with_effects.is_some() { WITH_EFFECTS } else { GIVEN };
    let mut bands = vec![Band { profile: present, label: "fitted", color, is_dashed: false }];
    if profiles.with_effects.is_some() {
        bands[0].label = "fitted with effects";
        let as_given = Band { profile: &profiles.as_given, label: "without effects", color: GIVEN, is_dashed: true };
        bands.insert(0, as_given);
    }
    let segments = bands
        .iter()
        .flat_map(|band| &band.profile.quantities)
        .flat_map(|quantity| quantity.segments.iter().filter(|segment| segment.given.is_some()).copied())
        .collect();
    let (reach, beyond) = reach(segments);
    let greatest = present.quantities.iter().map(|one| stated(present, one)).fold(reach, f64::max);
    let scale = 1.05 * (100.0 * greatest).max(LEAST_PERCENT);
    let count = present.quantities.len();
    let of_quantities = if count > 0 { PANEL.1 } else { 0 };
    let of_groups = if present.groups.is_empty() { 0 } else { ROW * present.groups.len() as u32 + AROUND_ROWS };
    // The legend of two models needs the width of five panels.
    let size = (PANEL.0 * count.max(3 + bands.len()) as u32, HEADER + of_quantities + of_groups);
    picture("the profile", size, |root| {
        let (header, body) = root.split_vertically(HEADER);
        let with =
            if present.effects.is_empty() { String::new() } else { format!(", with {}", present.effects.join(", ")) };
        header.draw(&Text::new(
            format!("{structure}: fitted stiffness and mass{with}"),
            (10, 8),
            ("sans-serif", 16),
        ))?;
        legend(&header, &bands, &beyond)?;
        let (quantities, groups) = body.split_vertically(of_quantities);
        if of_groups > 0 {
            draw_groups(&groups, &bands)?;
        }
        if count == 0 {
            return Ok(());
        }
        let (panels, _) = quantities.split_horizontally(PANEL.0 * count as u32);
        for (index, panel) in panels.split_evenly((1, count)).iter().enumerate() {
            draw(panel, index, &bands, scale)?;
        }
        Ok(())
    })
}

/// How far bands reach, as a share of the table, and in words the heights of the few that reach much further than all others.
fn reach(mut segments: Vec<ProfileSegment>) -> (f64, Vec<String>) {
    let reach = |segment: &ProfileSegment| (segment.factor - 1.0).abs() + segment.std;
    let length_m = |segment: &ProfileSegment| segment.z_top_m - segment.z_bottom_m;
    let short_m = SHORT * segments.iter().map(length_m).sum::<f64>();
    segments.sort_by(|a, b| reach(b).total_cmp(&reach(a)));
    let mut sum_m = 0.0;
    let is_short = |segment: &&ProfileSegment| {
        sum_m += length_m(segment);
        sum_m < short_m
    };
    let short = segments.iter().take_while(is_short).count();
    let usual = segments.get(short).map_or(0.0, reach);
    let far = segments[..short].partition_point(|segment| reach(segment) > FAR * usual);
    let mut words: Vec<String> = segments[..far]
        .iter()
        .map(|segment| format!("{:.0} to {:.0} m", segment.z_bottom_m, segment.z_top_m))
        .collect();
    words.sort();
    words.dedup();
    (segments.get(far).map_or(0.0, reach), words)
}

fn legend(header: &Area<'_>, bands: &[Band<'_>], beyond: &[String]) -> DrawResult {
    let y = 36;
    let words = |x: i32, text: &str| Text::new(text.to_owned(), (x, y - 6), ("sans-serif", 12));
    header.draw(&Rectangle::new([(12, y - 5), (34, y + 5)], REJECTED.mix(TOLERANCE).filled()))?;
    header.draw(&words(40, "tolerance that study.toml states"))?;
    for (index, band) in bands.iter().enumerate() {
        let x = 300 + 190 * index as i32;
        header.draw(&Rectangle::new([(x, y - 5), (x + 22, y + 5)], band.color.mix(0.25).filled()))?;
        let dashes: &[[i32; 2]] = if band.is_dashed { &[[0, 5], [8, 13], [16, 21]] } else { &[[0, 22]] };
        for [from, to] in dashes {
            header.draw(&PathElement::new([(x + from, y), (x + to, y)], band.color.stroke_width(2)))?;
        }
        header.draw(&words(x + 28, band.label))?;
    }
    let beyond = if beyond.is_empty() { String::new() } else { format!("; beyond the scale: {}", beyond.join(", ")) };
    header.draw(&words(300 + 190 * bands.len() as i32, &format!("bands: ± one standard deviation{beyond}")))?;
    Ok(())
}

/// The deviation that the study states of a quantity, however far segments of the fit scatter.
fn stated(profile: &Profile, quantity: &QuantityProfile) -> f64 {
    quantity.prior_std() / profile.discrepancy.scatter
}

/// What a quantity is called above its panel.
fn title(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Bending1 => "bending, first axis",
        Quantity::Bending2 => "bending, second axis",
        Quantity::Shear1 => "shear, first axis",
        Quantity::Shear2 => "shear, second axis",
        Quantity::Torsion => "torsional stiffness",
        Quantity::Mass => "mass",
    }
}

fn draw(panel: &Area<'_>, index: usize, bands: &[Band<'_>], scale: f64) -> DrawResult {
    let of = |band: &Band<'_>| -> Vec<ProfileSegment> {
        let segments = band.profile.quantities.get(index).map_or(&[][..], |quantity| &quantity.segments);
        segments.iter().copied().filter(|segment| segment.given.is_some()).collect()
    };
    let Some(QuantityProfile { quantity, segments, .. }) = bands[0].profile.quantities.get(index) else {
        return Ok(());
    };
    let (Some(lowest), Some(highest)) = (segments.first(), segments.last()) else { return Ok(()) };
    let mut chart = ChartBuilder::on(panel)
        .caption(title(*quantity), ("sans-serif", 13))
        .margin(6)
        .x_label_area_size(34)
        .y_label_area_size(if index == 0 { 44 } else { 30 })
        .build_cartesian_2d(-scale..scale, lowest.z_bottom_m..highest.z_top_m)?;
    let std = stated(bands[0].profile, &bands[0].profile.quantities[index]);
    let before = |one: ProfileSegment| ProfileSegment { factor: 1.0, std, ..one };
    let tolerance: Vec<ProfileSegment> = of(&bands[0]).into_iter().map(before).collect();
    chart.draw_series(std::iter::once(Polygon::new(outline(&tolerance, scale), REJECTED.mix(TOLERANCE).filled())))?;
    chart
        .configure_mesh()
        .disable_mesh()
        .x_labels(5)
        .y_labels(6)
        .x_desc("% of the table")
        .y_desc(if index == 0 { "height in m" } else { "" })
        .x_label_formatter(&|percent| if *percent == 0.0 { "0".to_owned() } else { format!("{percent:+.0}") })
        .y_label_formatter(&|z_m| format!("{z_m:.0}"))
        .label_style(("sans-serif", 11))
        .axis_style(FRAME)
        .draw()?;
    let plane = Plane::of(&chart, -scale..scale, lowest.z_bottom_m..highest.z_top_m, false);
    plane.curve([(0.0, lowest.z_bottom_m), (0.0, highest.z_top_m)], Dashes::Full, INK.stroke_width(1))?;
    for band in bands {
        let segments = of(band);
        chart.draw_series(std::iter::once(Polygon::new(outline(&segments, scale), band.color.mix(0.25).filled())))?;
        let middle = side(&segments, 0.0, scale);
        let dashes = if band.is_dashed { Dashes::Short } else { Dashes::Full };
        plane.curve(middle, dashes, band.color.stroke_width(2))?;
    }
    Ok(())
}

/// A row a group, the highest first where heights are known: its change in percent with one standard deviation either way, over what it is
/// trusted to.
fn draw_groups(panel: &Area<'_>, bands: &[Band<'_>]) -> DrawResult {
    let Some(first) = bands.first() else { return Ok(()) };
    let order = first.profile.groups_from_the_top();
    let reach = |group: &ProfileGroup| 100.0 * ((group.factor - 1.0).abs() + group.std);
    let all = bands.iter().flat_map(|band| &band.profile.groups).map(reach).fold(LEAST_PERCENT, f64::max);
    let scale = 1.05 * all;
    let names = order.iter().map(|&at| width_of(&first.profile.groups[at].name, 12)).max().unwrap_or(0);
    let rows = -0.5..order.len() as f64 - 0.5;
    let mut chart = ChartBuilder::on(panel)
        .margin(6)
        .margin_right(14)
        .x_label_area_size(34)
        .y_label_area_size(names + 16)
        .build_cartesian_2d(-scale..scale, rows.clone())?;
    chart
        .configure_mesh()
        .disable_mesh()
        .y_labels(0)
        .x_labels(9)
        .x_desc("% of the group's own part of the model")
        .x_label_formatter(&|percent| if *percent == 0.0 { "0".to_owned() } else { format!("{percent:+.0}") })
        .label_style(("sans-serif", 11))
        .axis_style(FRAME)
        .draw()?;
    let style = ("sans-serif", 12).into_text_style(panel).pos(Pos::new(HPos::Right, VPos::Center));
    for (row, &at) in order.iter().enumerate() {
        let y = (order.len() - 1 - row) as f64;
        let group = &first.profile.groups[at];
        let stated = (100.0 * group.prior_std / first.profile.discrepancy.scatter).min(scale);
        let tolerance = Rectangle::new([(-stated, y - 0.32), (stated, y + 0.32)], REJECTED.mix(TOLERANCE).filled());
        chart.draw_series(std::iter::once(tolerance))?;
        chart.draw_series(std::iter::once(Text::new(group.name.clone(), (-scale * 1.01, y), style.clone())))?;
    }
    let plane = Plane::of(&chart, -scale..scale, rows.clone(), false);
    plane.curve([(0.0, rows.start), (0.0, rows.end)], Dashes::Full, INK.stroke_width(1))?;
    for (number, band) in bands.iter().enumerate() {
        // Two models of one group stand above each other.
        let beside = if bands.len() > 1 { 0.16 - 0.32 * number as f64 } else { 0.0 };
        for (row, &at) in order.iter().enumerate() {
            let Some(group) = band.profile.groups.get(at) else { continue };
            let y = (order.len() - 1 - row) as f64 + beside;
            let at = |deviations: f64| 100.0 * (group.factor - 1.0 + deviations * group.std);
            plane.curve([(at(-1.0), y), (at(1.0), y)], Dashes::Full, band.color.stroke_width(2))?;
            plane.dot((at(0.0), y), 4, band.color.filled())?;
        }
    }
    Ok(())
}

/// Changes in percent this many deviations away, bottom and top of each segment, none beyond the scale.
fn side(segments: &[ProfileSegment], deviations: f64, scale: f64) -> Vec<(f64, f64)> {
    let ends = |segment: &ProfileSegment| {
        let percent = (100.0 * (segment.factor - 1.0 + deviations * segment.std)).clamp(-scale, scale);
        [(percent, segment.z_bottom_m), (percent, segment.z_top_m)]
    };
    segments.iter().flat_map(ends).collect()
}

/// The outline of a band of one standard deviation either way.
fn outline(segments: &[ProfileSegment], scale: f64) -> Vec<(f64, f64)> {
    let mut outline = side(segments, -1.0, scale);
    outline.extend(side(segments, 1.0, scale).into_iter().rev());
    outline
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_short_segment_far_off_does_not_set_the_scale() {
        let segment = |index: u32, factor: f64| ProfileSegment {
            z_bottom_m: f64::from(index),
            z_top_m: f64::from(index + 1),
            given: Some(1.0),
            factor,
            std: 0.01,
            prior_std: 0.03,
        };
        let mut segments: Vec<ProfileSegment> = (0..40).map(|index| segment(index, 1.03)).collect();
        let (all, beyond) = reach(segments.clone());
        assert!((all - 0.04).abs() < 1e-12 && beyond.is_empty());
        segments[7].factor = 0.4;
        let (others, beyond) = reach(segments.clone());
        assert!((others - 0.04).abs() < 1e-12);
        assert_eq!(beyond, ["7 to 8 m"]);
        // Many that are far off are what there is to see.
        segments[..10].iter_mut().for_each(|segment| segment.factor = 0.4);
        assert!((reach(segments).0 - 0.61).abs() < 1e-12);
        assert_eq!(reach(Vec::new()), (0.0, Vec::new()));
    }
}
