use super::*;
use clap::Parser;

#[derive(Debug, Parser)]
struct Cli {
    #[command(flatten)]
    args: UquadArgs,
}

fn args(folder: &Path, more: &[&str]) -> Result<UquadArgs, clap::Error> {
    let at = |name: &str| folder.join(name).display().to_string();
    let (raw, calib, out) = (at("raw.log"), at("calib.txt"), at("out"));
    let words = [
        "eval", "--raw", &raw, "--calib", &calib, "--out", &out, "--quiet",
    ];
    Cli::try_parse_from(words.iter().chain(more)).map(|c| c.args)
}

/// A board on a table: 300 frames and a square calibration in a folder of its own.
fn table(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("kestrel-uquad-{}-{name}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    let calibration = "0.04 0 0 0 0.04 0 0 0 0.04 0 0 0 0.00125 0 0 0 0.00125 0 0 0 0.00125 0 0 0 \
                       0.004 0 0 0 0.004 0 0 0 0.004 0 0 0";
    std::fs::write(folder.join("calib.txt"), calibration).unwrap();
    let log: String = (0..300)
        .map(|k| {
            let f = k % 3 - 1;
            format!(
                "100\t{}\t10000\t{f}\t2\t{}\t{}\t-7\t{}\t{}\t20\t-150\t280\t101000\n",
                10_000 * k / 4,
                245 - f,
                5 + f,
                2 * f,
                150 + f
            )
        })
        .collect();
    std::fs::write(folder.join("raw.log"), log).unwrap();
    folder
}

fn error(folder: &Path, more: &[&str]) -> String {
    format!("{:#}", run(&args(folder, more).unwrap()).unwrap_err())
}

#[test]
fn every_stage_picture_and_summary_are_written() {
    let folder = table("stages");
    for mode in [&["--legacy"][..], &["--calibration-frames", "100"]] {
        assert_eq!(
            run(&args(&folder, mode).unwrap()).unwrap(),
            ExitCode::SUCCESS
        );
        let out = folder.join("out");
        let read = |name: &str| std::fs::read_to_string(out.join(name)).unwrap();
        let rows = if mode.len() == 1 { 100 } else { 201 };
        for (name, columns) in [("kalman_in.csv", 13), ("x_hat.csv", 16), ("w.csv", 5)] {
            let text = read(name);
            assert_eq!(text.lines().count(), rows + 1, "{name}");
            for line in text.lines() {
                assert_eq!(line.split(',').count(), columns, "{name}: {line}");
            }
        }
        let summary: serde_json::Value = serde_json::from_str(&read("summary.json")).unwrap();
        assert_eq!(summary["estimates"], rows);
        assert!((summary["converted"]["az_mps2"]["mean"].as_f64().unwrap() - 9.8).abs() < 0.05);
        assert_eq!(read("uquad.svg").matches("<polyline").count(), 18);
    }
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn what_cannot_be_used_is_refused_with_file_and_reason() {
    let folder = table("refused");
    assert!(error(&folder, &[]).contains("300 usable rows, 512 are needed"));
    let few = error(&folder, &["--legacy", "--start", "400"]);
    assert!(few.contains("401 are needed") && few.contains("--start ROW"));
    assert!(error(&folder, &["--fir", "0.5,0.6"]).contains("add up to 1.1"));
    assert!(error(&folder, &["--calibration-frames", "100", "--mass=-1"]).contains("mass = -1"));
    assert!(error(&folder, &["--legacy", "--p0", "7"]).contains("30000-110000"));

    let gains = folder.join("K.txt");
    std::fs::write(&gains, "1 2 3").unwrap();
    let path = gains.display().to_string();
    let reason = error(&folder, &["--gains", &path]);
    assert!(
        reason.contains("K.txt") && reason.contains("4 x 12 = 48 are needed"),
        "{reason}"
    );
    assert!(
        args(&folder, &["--integral", &path]).is_err(),
        "the column order must be said"
    );
    assert!(args(&folder, &["--legacy", "--mass", "1.5"]).is_err());

    let calibration = std::fs::read_to_string(folder.join("calib.txt")).unwrap();
    let cut = calibration.rsplit_once(' ').unwrap().0;
    std::fs::write(folder.join("calib.txt"), cut).unwrap();
    let reason = error(&folder, &["--legacy"]);
    assert!(reason.contains("calib.txt") && reason.contains("magnetometer b z is missing"));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn bad_rows_are_counted_with_their_reason_and_the_rest_is_used() {
    let folder = table("rows");
    let path = folder.join("raw.log");
    let log = std::fs::read_to_string(&path).unwrap();
    let mut lines: Vec<String> = log.lines().map(str::to_owned).collect();
    lines[210] = "not a row".to_owned();
    lines[220] = lines[220].replace("\t-7\t", "\tNaN\t");
    lines[230] = lines[229].clone();
    lines[240] = lines[100].clone();
    let (frames, refused) = read_rows(&lines.join("\n"));
    assert_eq!(frames.len(), 296);
    assert_eq!(
        refused,
        [
            "line 211: 3 columns, imu_raw has 14",
            "line 221: gy is not a number of its range",
            "line 231: the same row twice",
            "line 241: host time runs backwards"
        ]
    );
    std::fs::write(&path, lines.join("\n")).unwrap();
    assert_eq!(
        run(&args(&folder, &["--legacy"]).unwrap()).unwrap(),
        ExitCode::SUCCESS
    );
    std::fs::write(&path, "nothing\n").unwrap();
    assert!(error(&folder, &["--legacy"]).contains("no usable row"));
    std::fs::remove_dir_all(folder).unwrap();
}

#[test]
fn a_log_of_text_frames_is_read_too() {
    let line = "A\t10000\t12\t-11\t205\t-22\t-31\t-14\t-94\t129\t7\t250\t101202\tZ\r\n";
    let (frames, refused) = read_rows(&line.repeat(3));
    assert_eq!((frames.len(), refused.len()), (3, 0));
}

#[test]
fn streams_in_a_flight_log_come_back_as_text_and_give_the_same_run_to_the_bit() {
    let folder = table("log");
    let log = folder.join("run.mcap");
    let words = ["--calibration-frames", "100", "--log"];
    let more: Vec<&str> = words.into_iter().chain(log.to_str()).collect();
    run(&args(&folder, &more).unwrap()).unwrap();
    let results = |out: &Path| {
        ["kalman_in.csv", "x_hat.csv", "w.csv"].map(|name| std::fs::read(out.join(name)).unwrap())
    };
    let first = results(&folder.join("out"));
    let raw = std::fs::read_to_string(folder.join("raw.log")).unwrap();

    let file = crate::cmd::log::read(&log).unwrap();
    assert!(file.metadata["uquad"]["calibration"].starts_with("0.04 0 0"));
    let back: String = file
        .values("/uquad/imu_raw")
        .map(|(_, row)| bridge::log::uquad::line("imu_raw", &row).unwrap())
        .collect();
    assert_eq!(back, raw);
    std::fs::write(folder.join("raw.log"), back).unwrap();
    std::fs::remove_dir_all(folder.join("out")).unwrap();
    run(&args(&folder, &words[..2]).unwrap()).unwrap();
    assert!(results(&folder.join("out")) == first, "another run");
    std::fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn fixes_hold_the_horizontal_position_and_eight_states_refuse_them() {
    let folder = table("gps");
    let last = |more: &[&str]| {
        let words = [&["--calibration-frames", "100", "--logs", "x_hat"], more].concat();
        assert_eq!(
            run(&args(&folder, &words).unwrap()).unwrap(),
            ExitCode::SUCCESS
        );
        let out = folder.join("out");
        assert!(out.join("x_hat.csv").exists() && out.join("summary.json").exists());
        assert!(!out.join("w.csv").exists() && !out.join("uquad.svg").exists());
        let text = std::fs::read_to_string(out.join("x_hat.csv")).unwrap();
        let row = text.lines().last().unwrap().to_owned();
        std::fs::remove_dir_all(&out).unwrap();
        row
    };
    let without = last(&[]);
    assert_ne!(without, last(&["--gps", "random"]));
    let log = folder.join("gps.log");
    std::fs::write(
        &log,
        "0 3 1 2 0 0 0 0 -34.9 -56.1 0 0 0 0\n0.2 3 1 2 0 0 0 0 -34.9 -56.1 0 0 0 0\n",
    )
    .unwrap();
    assert_ne!(without, last(&["--gps", &log.display().to_string()]));
    assert_ne!(without, last(&["--inertia", "0.03,0.05"]));
    assert_ne!(without, last(&["--frames-per-action", "5"]));
    let both = error(&folder, &["--gps", "zeros", "--states", "8"]);
    assert!(
        both.contains("--gps zeros and --states 8") && both.contains("estimate 12"),
        "{both}"
    );
    let never = error(
        &folder,
        &["--calibration-frames", "100", "--frames-per-action", "0"],
    );
    assert!(never.contains("acts every step"), "{never}");
    assert!(
        error(
            &folder,
            &["--calibration-frames", "100", "--inertia", "0,1"]
        )
        .contains("0-10 kg m2")
    );
    std::fs::write(&log, "0 3\n").unwrap();
    assert!(
        error(
            &folder,
            &[
                "--calibration-frames",
                "100",
                "--gps",
                &log.display().to_string()
            ]
        )
        .contains("line 1")
    );
    std::fs::remove_dir_all(&folder).unwrap();
}
