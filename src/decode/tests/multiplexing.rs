//! Which signals are in a frame.

use super::{decoder, frame, names, parse};

const SIMPLE: &str = "BO_ 16 A: 8 X
 SG_ always : 56|8@1+ (1,0) [0|0] \"\" Y
 SG_ page M : 0|8@1+ (1,0) [0|0] \"\" Y
 SG_ a m0 : 8|8@1+ (1,0) [0|0] \"\" Y
 SG_ b m1 : 8|16@1+ (1,0) [0|0] \"\" Y
";

/// `page` selects `sub` (1) and `range` (2-4, 9); `sub` selects `deep` (7).
const EXTENDED: &str = "BO_ 16 A: 8 X
 SG_ page M : 0|8@1+ (1,0) [0|0] \"\" Y
 SG_ sub m1M : 8|8@1+ (1,0) [0|0] \"\" Y
 SG_ deep m7 : 16|8@1+ (1,0) [0|0] \"\" Y
 SG_ range m2 : 8|8@1+ (1,0) [0|0] \"\" Y
SG_MUL_VAL_ 16 sub page 1-1;
SG_MUL_VAL_ 16 deep sub 7-7;
SG_MUL_VAL_ 16 range page 3-4, 2-2,9-9;
";

#[test]
fn only_the_selected_signals_are_in_a_frame() {
    let decoder = decoder(SIMPLE);
    assert_eq!(names(&decoder, &frame(16, &[0; 8])), ["always", "page", "a"]);
    assert_eq!(names(&decoder, &frame(16, &[1, 0, 0, 0, 0, 0, 0, 0])), ["always", "page", "b"]);
    assert_eq!(names(&decoder, &frame(16, &[2, 0, 0, 0, 0, 0, 0, 0])), ["always", "page"]);
    // Without the switch nobody knows.
    assert_eq!(names(&decoder, &frame(16, &[])), Vec::<String>::new());
}

#[test]
fn switches_upon_switches_and_ranges() {
    let decoder = decoder(EXTENDED);
    let of = |page, sub| names(&decoder, &frame(16, &[page, sub, 0, 0, 0, 0, 0, 0]));
    assert_eq!(of(1, 0), ["page", "sub"]);
    assert_eq!(of(1, 7), ["page", "sub", "deep"]);
    // `sub` is not in this frame, though its bits are 7.
    assert_eq!(of(2, 7), ["page", "range"]);
    for page in [2, 3, 4, 9] {
        assert_eq!(of(page, 0), ["page", "range"]);
    }
    for page in [0, 5, 8, 10] {
        assert_eq!(of(page, 0), ["page"]);
    }
}

#[test]
fn what_nothing_can_select_is_said_and_never_decoded() {
    let no_switch = "BO_ 16 A: 8 X\n SG_ a m0 : 8|8@1+ (1,0) [0|0] \"\" Y\n";
    assert_eq!(parse(no_switch).oddities.lost(), 1);
    assert_eq!(names(&decoder(no_switch), &frame(16, &[0; 8])), Vec::<String>::new());
    let circle = "BO_ 16 A: 8 X\n SG_ a m0M : 0|8@1+ (1,0) [0|0] \"\" Y\n\
         \x20SG_ b m0M : 8|8@1+ (1,0) [0|0] \"\" Y\n SG_ c : 16|8@1+ (1,0) [0|0] \"\" Y\n\
        SG_MUL_VAL_ 16 a b 0-0;\nSG_MUL_VAL_ 16 b a 0-0;\n";
    assert_eq!(parse(circle).oddities.lost(), 2);
    assert_eq!(names(&decoder(circle), &frame(16, &[0; 8])), ["c"]);
    // Nor what such a signal would select.
    let below = format!("{circle}SG_MUL_VAL_ 16 c a 0-0;\n");
    assert_eq!(names(&decoder(&below), &frame(16, &[0; 8])), Vec::<String>::new());
    let lost = "BO_ 16 A: 8 X\n SG_ a m0M : 0|8@1+ (1,0) [0|0] \"\" Y\n\
         \x20SG_ b : 8|8@1+ (1,0) [0|0] \"\" Y\nSG_MUL_VAL_ 16 b a 0-0;\n";
    assert_eq!(names(&decoder(lost), &frame(16, &[0; 8])), Vec::<String>::new());
}
