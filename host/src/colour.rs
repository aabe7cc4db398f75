//! One table of colours: the page, the report and the pictures that commands write give one thing one colour.
//!
//! What stands for something has a colour that colour-blind people can tell from the others, on white paper and on a dark screen. The page
//! gets all of them as properties of its style, pictures take those of paper.

use plotters::style::RGBColor;

/// A colour by the name that the page's style has for it.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Colour {
    name: &'static str,
    light: u32,
    dark: u32,
}

impl Colour {
    const fn new(name: &'static str, light: u32, dark: u32) -> Self {
        Self { name, light, dark }
    }

    /// As it is on paper.
    pub(crate) const fn on_paper(self) -> RGBColor {
        let [_, red, green, blue] = self.light.to_be_bytes();
        RGBColor(red, green, blue)
    }
}

/// What was measured.
pub(crate) const MEASURED: Colour = Colour::new("measured", 0x0068a8, 0x3f9be6);
/// The model as first given.
pub(crate) const GIVEN: Colour = Colour::new("given", 0xb83200, 0xf2702a);
/// The model with its effects, and what an effect would do.
pub(crate) const EFFECTS: Colour = Colour::new("effects", 0x009873, 0x2fd0a0);
/// The model after its direct update.
pub(crate) const UPDATED: Colour = Colour::new("updated", 0xd062ab, 0xf4a9de);
/// Forced lines.
pub(crate) const FORCED: Colour = Colour::new("forced", 0xad8400, 0xf5dc6e);
/// What was rejected, and what stands behind something else.
pub(crate) const REJECTED: Colour = Colour::new("rejected", 0x555555, 0x8a8a8a);
/// What is bad: a misfit, a failure.
pub(crate) const BAD: Colour = Colour::new("bad", 0xb3261e, 0xff8d85);
/// Text, axes, and what has no colour of its own, such as a fit.
pub(crate) const INK: Colour = Colour::new("ink", 0x16191d, 0xe8eaed);
/// Frames and grids.
pub(crate) const LINE: Colour = Colour::new("line", 0xd5d9de, 0x3a4047);
/// Misfit where it is strong.
pub(crate) const HIGH: Colour = Colour::new("high", 0xa33b00, 0xff9b57);
/// Motion that is less, and more, than the model's.
pub(crate) const LESS: Colour = Colour::new("less", 0x8c510a, 0xe8a25c);
pub(crate) const MORE: Colour = Colour::new("more", 0x01665e, 0x5cc9bd);
/// Curves that mean nothing but "another one", after that of what was measured.
pub(crate) const SERIES: [Colour; 5] = [
    Colour::new("series-2", 0xb8860b, 0xffe08a),
    Colour::new("series-3", 0x7a1650, 0xf07aa8),
    Colour::new("series-4", 0x0d6a32, 0x3c9a57),
    Colour::new("series-5", 0x2e2a8c, 0xc3b8ff),
    Colour::new("series-6", 0x8a8a8a, 0xd8d8d8),
];
/// What the page alone has: words in the colours above, which have to be read, and its surfaces.
const OF_THE_PAGE: [Colour; 8] = [
    Colour::new("given-text", 0xb83200, 0xf2702a),
    Colour::new("effects-text", 0x007a59, 0x2fd0a0),
    Colour::new("updated-text", 0xa64f80, 0xf4a9de),
    Colour::new("forced-text", 0x7d5f00, 0xf5dc6e),
    Colour::new("quiet", 0x596069, 0xa4abb4),
    Colour::new("paper", 0xffffff, 0x14171a),
    Colour::new("panel", 0xf5f6f8, 0x1e2226),
    Colour::new("low", 0xf2f4f7, 0x262b31),
];

fn all() -> impl Iterator<Item = Colour> {
    let pictures = [MEASURED, GIVEN, EFFECTS, UPDATED, FORCED, REJECTED, BAD, INK, LINE, HIGH, LESS, MORE];
    pictures.into_iter().chain(SERIES).chain(OF_THE_PAGE)
}

/// The colours as the page's style has them: light, and dark where the system or the reader wants it; paper is light.
pub(crate) fn style() -> String {
    let scheme = |name: &str, of: fn(Colour) -> u32| {
        let properties: String = all().map(|colour| format!("--{}: #{:06x}; ", colour.name, of(colour))).collect();
        format!("{{ {properties}color-scheme: {name}; }}")
    };
    let (light, dark) = (scheme("light", |colour| colour.light), scheme("dark", |colour| colour.dark));
    format!(
        ":root {light}\n\
         @media screen and (prefers-color-scheme: dark) {{ :root:not([data-theme=\"light\"]):not(.printing) {dark} }}\n\
         @media screen {{ :root[data-theme=\"dark\"]:not(.printing) {dark} }}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    type Light = [f64; 3];

    /// Red, green and blue as amounts of light.
    fn light_of(colour: u32) -> Light {
        let [_, rgb @ ..] = colour.to_be_bytes();
        rgb.map(|part| {
            let part = f64::from(part) / 255.0;
            if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
        })
    }

    /// The ratio of contrast (WCAG 2.2).
    fn contrast(a: u32, b: u32) -> f64 {
        let luminance = |colour| light_of(colour).iter().zip([0.2126, 0.7152, 0.0722]).map(|(l, w)| l * w).sum::<f64>();
        let (a, b) = (luminance(a), luminance(b));
        (a.max(b) + 0.05) / (a.min(b) + 0.05)
    }

    fn times(matrix: &[[f64; 3]; 3], [x, y, z]: Light) -> Light {
        matrix.map(|[a, b, c]| a * x + b * y + c * z)
    }

    /// Lightness and two of hue, in which equal distances look equal (Ottosson 2020, Oklab).
    fn seen(light: Light) -> Light {
        const CONES: [[f64; 3]; 3] = [
            [0.412_221_470_8, 0.536_332_536_3, 0.051_445_992_9],
            [0.211_903_498_2, 0.680_699_545_1, 0.107_396_956_6],
            [0.088_302_461_9, 0.281_718_837_6, 0.629_978_700_5],
        ];
        const LAB: [[f64; 3]; 3] = [
            [0.210_454_255_3, 0.793_617_785_0, -0.004_072_046_8],
            [1.977_998_495_1, -2.428_592_205_0, 0.450_593_709_9],
            [0.025_904_037_1, 0.782_771_766_2, -0.808_675_766_0],
        ];
        times(&LAB, times(&CONES, light.map(|part| part.clamp(0.0, 1.0))).map(f64::cbrt))
    }

    /// Eyes of all cones, and without those for long, middle and short waves (Machado, Oliveira, Fernandes 2009).
    const EYES: [[[f64; 3]; 3]; 4] = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]],
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]],
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]],
    ];

    /// The least difference of two of these colours to any eye.
    fn least_difference(colours: &[u32]) -> f64 {
        let of_eye = |eye: &[[f64; 3]; 3]| {
            let seen: Vec<Light> = colours.iter().map(|colour| seen(times(eye, light_of(*colour)))).collect();
            let difference = |a: &Light, b: &Light| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
            let pairs =
                seen.iter().enumerate().flat_map(|(at, a)| seen[at + 1..].iter().map(move |b| difference(a, b)));
            pairs.fold(f64::INFINITY, f64::min)
        };
        EYES.iter().map(of_eye).fold(f64::INFINITY, f64::min)
    }

    /// A difference of 0.02 is just seen side by side; these are to be known apart across a page.
    #[test]
    fn every_eye_tells_the_colours_apart() {
        let things = [MEASURED, GIVEN, EFFECTS, UPDATED, FORCED, REJECTED];
        let series: Vec<Colour> = std::iter::once(MEASURED).chain(SERIES).collect();
        for (colours, least) in [(&things[..], 0.07), (&series[..], 0.05)] {
            for of in [|colour: &Colour| colour.light, |colour: &Colour| colour.dark] {
                let difference = least_difference(&colours.iter().map(of).collect::<Vec<_>>());
                assert!(difference >= least, "{difference}");
            }
        }
    }

    /// Words have a contrast of 4.5, curves and marks one of 3 (WCAG 2.2, 1.4.3 and 1.4.11).
    #[test]
    fn colours_are_seen_on_both_grounds() {
        let named = |name: &str| all().find(|colour| colour.name == name).unwrap();
        let grounds = ["paper", "panel"].map(named);
        let is_surface = |colour: &Colour| ["paper", "panel", "low", "line"].contains(&colour.name);
        let is_read = |name: &str| name.ends_with("-text") || ["ink", "quiet", "bad", "measured"].contains(&name);
        for colour in all().filter(|colour| !is_surface(colour)) {
            let least = if is_read(colour.name) { 4.5 } else { 3.0 };
            for ground in grounds {
                for (a, b) in [(colour.light, ground.light), (colour.dark, ground.dark)] {
                    assert!(contrast(a, b) >= least, "{} on {}: {}", colour.name, ground.name, contrast(a, b));
                }
            }
        }
    }

    #[test]
    fn the_style_names_every_colour_that_the_page_asks_for() {
        let style = style();
        let page = include_str!("../page/style.css");
        for asked in page.split("var(--").skip(1).filter_map(|rest| rest.split(')').next()) {
            assert!(style.contains(&format!("--{asked}: #")), "{asked}");
        }
    }

    /// Neither the page's style nor a picture has a colour of its own.
    #[test]
    fn the_table_alone_has_colours() {
        let is_hex = |word: &str| word.len() >= 3 && word.bytes().take(3).all(|letter| letter.is_ascii_hexdigit());
        let style = include_str!("../page/style.css");
        assert_eq!(style.split(": #").skip(1).find(|rest| is_hex(rest)), None);
        let pictures = std::fs::read_dir(concat!(env!("CARGO_MANIFEST_DIR"), "/src/picture")).unwrap();
        for file in pictures.map(|file| file.unwrap().path()) {
            let code = std::fs::read_to_string(&file).unwrap();
            let of_numbers = |rest: &&str| rest.trim_start().starts_with(|letter: char| letter.is_ascii_digit());
            assert_eq!(code.split("RGBColor(").skip(1).find(of_numbers), None, "{}", file.display());
        }
    }
}
