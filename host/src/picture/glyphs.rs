//! Letters for pictures of pixels: a text and a place flow in, strokes on the picture flow out.
//!
//! A letter is a few strokes on a grid, so that it is sharp at any size and needs no file of a font.

use plotters::style::RGBColor;

use super::raster::{Pixels, stroke};

/// Rows of the grid between the top of a capital letter and the line; letters below it reach two rows further.
pub(super) const CAPITAL: f64 = 6.0;
/// Columns between letters.
const GAP: f64 = 2.0;
/// Half the width of a stroke over a step of the grid.
const HALF_WIDTH: f64 = 0.36;
/// What is drawn where there is no letter: an empty box.
const UNKNOWN: (u8, &str) = (4, "0040460600");
const DEGREE: (u8, &str) = (1, "0010110100");
/// The first of the table, a blank.
const FIRST: char = ' ';
/// Printable ASCII: the width in columns, and strokes as pairs of column (from the left) and row (from the top of a capital).
#[rustfmt::skip]
const LETTERS: [(u8, &str); 95] = [
    (3, ""), (0, "0004 0606"), (2, "0002 2022"), (4, "1016 3036 0242 0444"), (4, "413010010213334445361605 2026"),
    (4, "0010110100 3545463635 4006"), (4, "4612112031320405162644"), (0, "0002"), (1, "10010516"), (1, "00111506"),
    (4, "2125 0244 4204"), (4, "2125 0343"), (1, "1607"), (3, "0333"), (0, "0606"), (3, "3006"),
    (4, "103041453616050110"), (2, "011016 0626"), (4, "01103041420646"), (4, "01103041423313 334445361605"),
    (4, "36300444"), (4, "40000312324345361605"), (4, "413010010516364544331304"), (4, "004016"),
    (4, "103041423313020110 133344453616050413"), (4, "051636454130100102133342"), (0, "0303 0606"),
    (1, "1313 1607"), (3, "310335"), (4, "0242 0444"), (3, "013305"), (4, "01103041422324 2626"),
    (4, "46160501103041443432222434"), (4, "062046 1434"), (4, "00063645443303 0030414233"), (4, "4130100105163645"),
    (4, "00062644422000"), (4, "40000646 0333"), (4, "400006 0333"), (4, "41301001051636454323"),
    (4, "0006 4046 0343"), (0, "0006"), (3, "3035261605"), (4, "0006 4004 1346"), (3, "000636"), (4, "0600234046"),
    (4, "06004640"), (4, "103041453616050110"), (4, "06003041423303"), (4, "103041453616050110 3546"),
    (4, "06003041423303 2346"), (4, "413010010213334445361605"), (4, "0040 2026"), (4, "000516364540"),
    (4, "002640"), (4, "0016223640"), (4, "0046 4006"), (4, "002340 2326"), (4, "00400646"), (1, "10000616"),
    (3, "0036"), (1, "00101606"), (4, "022042"), (4, "0747"), (1, "0011"), (3, "02223336 341405162635"),
    (3, "0006 0312223335261605"), (3, "3322120305162635"), (3, "3036 3322120305162635"), (3, "043433221203051636"),
    (2, "201116 0222"), (3, "32372808 3322120305162635"), (3, "0006 0312223336"), (0, "0206 0000"),
    (1, "121708 1010"), (3, "0006 3205 1436"), (0, "0006"), (4, "0206 03122326 23324346"), (3, "0206 0312223336"),
    (3, "122233352616050312"), (3, "0208 0312223335261605"), (3, "3238 3322120305162635"), (2, "0206 031222"),
    (3, "3212031424352606"), (2, "101526 0222"), (3, "0205162635 3236"), (4, "022642"), (4, "0216233642"),
    (3, "0236 3206"), (4, "0226 4218"), (3, "02320636"), (2, "20111203141526"), (0, "0008"), (2, "00111223141506"),
    (4, "04133443"),
];

/// Draws a text with its left end and its line at a place; `step` is the grid's, in pixels.
pub(super) fn write(canvas: &mut Pixels, text: &str, [left, line]: [f64; 2], step: f64, colour: RGBColor) {
    let mut x = left;
    for letter in text.chars() {
        let (width, strokes) = of(letter);
        for path in strokes.split(' ') {
            let mut before: Option<[f64; 2]> = None;
            let digits: Vec<u32> = path.chars().filter_map(|digit| digit.to_digit(10)).collect();
            for pair in digits.chunks_exact(2) {
                let at = [x + step * f64::from(pair[0]), line + step * (f64::from(pair[1]) - CAPITAL)];
                if let Some(from) = before {
                    stroke(canvas, from, at, (HALF_WIDTH * step).max(0.5), colour);
                }
                before = Some(at);
            }
        }
        x += step * (f64::from(width) + GAP);
    }
}

/// How wide a text is drawn, in pixels.
pub(super) fn width(text: &str, step: f64) -> f64 {
    let columns: f64 = text.chars().map(|letter| f64::from(of(letter).0) + GAP).sum();
    step * (columns - GAP).max(0.0)
}

/// As much of a text as fits, with dots where some is left out.
pub(super) fn fitting(text: &str, step: f64, most: f64) -> String {
    if width(text, step) <= most {
        return text.to_owned();
    }
    let mut short: String = text.to_owned();
    while short.pop().is_some() && width(&format!("{short}..."), step) > most {}
    format!("{}...", short.trim_end())
}

fn of(letter: char) -> (u8, &'static str) {
    let plain = match letter {
        '\u{b0}' => return DEGREE,
        '\u{2212}' | '\u{2013}' => '-',
        '\u{d7}' => 'x',
        '\u{e0}'..='\u{e5}' => 'a',
        '\u{c0}'..='\u{c5}' => 'A',
        '\u{e7}' => 'c',
        '\u{e8}'..='\u{eb}' => 'e',
        '\u{c8}'..='\u{cb}' => 'E',
        '\u{ec}'..='\u{ef}' => 'i',
        '\u{f1}' => 'n',
        '\u{f2}'..='\u{f6}' | '\u{f8}' => 'o',
        '\u{d2}'..='\u{d6}' | '\u{d8}' => 'O',
        '\u{f9}'..='\u{fc}' => 'u',
        '\u{d9}'..='\u{dc}' => 'U',
        '\u{df}' => 's',
        other => other,
    };
    let place = (plain as usize).checked_sub(FIRST as usize);
    place.and_then(|place| LETTERS.get(place)).copied().unwrap_or(UNKNOWN)
}

#[cfg(test)]
mod tests {
    use plotters::style::BLACK;

    use super::*;

    /// Every letter but the blank is drawn, within its columns and the rows of the grid, and no two look alike but 0 and O, and I and l.
    #[test]
    fn letters_are_drawn_within_their_place_and_differ() {
        let mut seen = std::collections::BTreeMap::new();
        for letter in (33..127_u8).map(char::from) {
            let (width, strokes) = of(letter);
            for path in strokes.split(' ') {
                let digits: Vec<u32> = path.chars().map(|digit| digit.to_digit(10).unwrap()).collect();
                assert!(digits.len() >= 4 && digits.len().is_multiple_of(2), "{letter}");
                assert!(digits.chunks(2).all(|pair| pair[0] <= u32::from(width) && pair[1] <= 8), "{letter}");
            }
            if let Some(other) = seen.insert(strokes, letter) {
                assert!([('0', 'O'), ('I', 'l')].contains(&(other, letter)), "{other} and {letter}");
            }
        }
        assert_eq!(of('\u{fc}'), of('u'));
        assert_eq!(of('\u{7}'), UNKNOWN);
    }

    #[test]
    fn a_text_is_as_wide_as_it_says_and_a_long_one_is_cut() {
        let mut canvas = Pixels::blank([200, 40]);
        write(&mut canvas, "Mode 12: 0.3 Hz", [10.0, 30.0], 2.0, BLACK);
        let inked = |(index, pixel): (usize, &[u8; 3])| (pixel != &[255; 3]).then_some(index % 200);
        let columns: Vec<usize> = canvas.rgb.iter().enumerate().filter_map(inked).collect();
        let (first, last) = (columns.iter().min().unwrap(), columns.iter().max().unwrap());
        assert!(
            first.abs_diff(10) <= 1 && last.abs_diff(10 + width("Mode 12: 0.3 Hz", 2.0) as usize) <= 2,
            "{first} {last}"
        );
        assert_eq!(fitting("short", 2.0, 200.0), "short");
        let cut = fitting(&"long ".repeat(40), 2.0, 200.0);
        assert!(cut.ends_with("...") && width(&cut, 2.0) <= 200.0, "{cut}");
    }
}
