//! Tables when something goes wrong: full disks, damaged recordings and logs.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use crate::disk::on_small_disk;
use crate::support::process::{Ran, args, bustape};

const DBC: &str = "BO_ 256 Engine: 8 A\n SG_ Speed : 0|16@1+ (0.01,0) [0|0] \"km/h\" B\n \
                   SG_ Torque : 16|16@1- (0.5,0) [0|0] \"Nm\" B\n SG_ Count : 32|32@1+ (1,0) [0|0] \"\" B\n";

/// `car.dbc`, and `can.log` with so many frames, a millisecond apart, whose content is hard to press.
fn inputs(folder: &Path, frames: u64) {
    let mut log = String::new();
    for number in 0..frames {
        let data = number.wrapping_mul(0x9E37_79B9_7F4A_7C15) & 0xFFFF_FFFF | number << 32;
        let time = 1_700_000_000_000 + number;
        let data = data.swap_bytes();
        writeln!(log, "({}.{:03}000) can0 100#{data:016X}", time / 1000, time % 1000).unwrap();
    }
    fs::write(folder.join("can.log"), log).unwrap();
    fs::write(folder.join("car.dbc"), DBC).unwrap();
}

#[test]
fn a_disk_that_fills_up_is_an_error_with_a_path_and_leaves_nothing() {
    let folder = tempfile::tempdir().unwrap();
    inputs(folder.path(), 150_000);
    for (format, more, file) in [
        ("parquet", "", "out.part/bus=can0/message=Engine/part-0000.parquet"),
        ("csv", "", "out.part/can0/Engine.csv"),
        ("jsonl", "", "out"),
        ("influx", "", "out"),
        ("csv", "--shape long", "out"),
        ("csv", "--shape wide --every 1ms", "out"),
        ("parquet", "--shape long", "out"),
        ("parquet", "--shape frames", "out"),
        ("csv", "--split hour", "out.part/can0/Engine-2023-11-14T22.csv"),
    ] {
        let decode = if more.contains("frames") { "" } else { "--decode \"$1/car.dbc\"" };
        let script = format!(
            "mount -t tmpfs -o size=256k none \"$1/disk\"
             status=0
             \"$2\" export \"$1/can.log\" {decode} --format {format} {more} -o \"$1/disk/out\" || status=$?
             ls -A \"$1/disk\"
             exit $status"
        );
        let ran = on_small_disk(&script, folder.path()).wait().expect(1);
        let path = folder.path().join("disk").join(file);
        let wanted = format!("error: cannot write {}", path.display());
        assert!(ran.err.starts_with(&wanted), "{format} {more}: {}", ran.err);
        assert!(ran.err.contains("No space left on device"), "{}", ran.err);
        assert!(ran.err.contains("make room or choose another disk"), "{}", ran.err);
        assert_eq!(ran.out, "", "{format} {more}: something is left");
        for of in ["disk", "found"] {
            fs::remove_dir(folder.path().join(of)).unwrap();
        }
    }
}

fn long(folder: &Path, input: &str) -> (Ran, String) {
    let out = folder.join("out.csv");
    let mut all = args(&[&"export", &folder.join(input), &"--decode", &folder.join("car.dbc")]);
    all.extend(args(&[&"--format", &"csv", &"--shape", &"long", &"--force", &"-o", &out]));
    let ran = bustape(all);
    (ran, fs::read_to_string(out).unwrap_or_default())
}

/// Recordings and logs that end in the middle.
#[test]
fn of_inputs_that_were_cut_off_all_that_is_intact_is_in_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    inputs(folder.path(), 60_000);
    let (ran, whole) = long(folder.path(), "can.log");
    ran.expect(0);
    let import = args(&[&"import", &path("can.log"), &"-o", &path("a.mcap"), &"--bus", &"can0"]);
    bustape(import).expect(0);
    for format in ["blf", "asc", "trc", "pcapng"] {
        let out = path(&format!("a.{format}"));
        bustape(args(&[&"export", &path("can.log"), &"--format", &format, &"-o", &out])).expect(0);
    }
    let mut gzip = std::process::Command::new("gzip");
    gzip.arg("-k").arg(path("can.log"));
    crate::support::process::spawn(gzip).wait().expect(0);
    for name in ["a.mcap", "a.blf", "a.asc", "a.trc", "a.pcapng", "can.log.gz"] {
        let (ran, table) = long(folder.path(), name);
        ran.expect(0);
        // Formats number their buses, and keep microseconds.
        let values = |table: &str| -> Vec<String> {
            let cells = table.lines().skip(1).map(|line| line.splitn(3, ',').nth(2).unwrap());
            cells.map(str::to_owned).collect()
        };
        let all = values(&whole);
        assert!(values(&table) == all, "{name}");
        let bytes = fs::read(path(name)).unwrap();
        let cut = format!("cut-{name}");
        fs::write(path(&cut), &bytes[..bytes.len() * 3 / 5 + 3]).unwrap();
        let (ran, table) = long(folder.path(), &cut);
        let ran = ran.expect(3);
        let rest = values(&table);
        assert!(rest.len() > all.len() / 3 && rest.len() < all.len(), "{name}: {}", rest.len());
        assert!(rest == all[..rest.len()], "{name}: not the first rows");
        assert!(ran.err.contains("warning"), "{name}: {}", ran.err);
        assert!(!path("out.csv.part").exists());
    }
}

/// A bit that tipped over in a chunk costs that chunk.
#[test]
fn of_a_damaged_recording_all_but_the_damage_is_in_the_table() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    inputs(folder.path(), 300_000);
    let import = args(&[&"import", &path("can.log"), &"-o", &path("a.mcap"), &"--bus", &"can0"]);
    bustape(import).expect(0);
    let (ran, whole) = long(folder.path(), "a.mcap");
    ran.expect(0);
    let mut bytes = fs::read(path("a.mcap")).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle..middle + 64].iter_mut().for_each(|byte| *byte ^= 0x55);
    fs::write(path("b.mcap"), &bytes).unwrap();
    let (ran, table) = long(folder.path(), "b.mcap");
    assert!(ran.expect(3).err.contains("b.mcap"));
    let (whole, rest): (Vec<_>, Vec<_>) = (whole.lines().collect(), table.lines().collect());
    assert!(rest.len() > whole.len() / 2 && rest.len() < whole.len());
    let mut all = whole.iter();
    assert!(rest.iter().all(|row| all.any(|other| other == row)), "a row that was not there");
}
