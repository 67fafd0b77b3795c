//! `kestrel msp`, and its `decode`: frames of a recorded line as JSON, for people with a logic analyser and for tests.

use super::msp_ask::AskArgs;
use super::msp_serve::ServeArgs;
use anyhow::{Context as _, Result};
use clap::{Args, Subcommand};
use msp::frame::{Accept, Counters, Decoder, Direction, Frame, Framing};
use msp::message::multiple::Replies;
use msp::{Order, ParseError, Reply, command};
use serde_json::{Map, Value, json};
use std::fs::File;
use std::io::{BufRead, BufReader, BufWriter, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Look into the protocol of flight controllers.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  kestrel msp decode capture.bin\n  echo 244d3e066c85ff2d000e0132 | kestrel msp decode --hex -\n  kestrel msp ask tcpclient://127.0.0.1:5761 attitude analog\n  kestrel msp serve"
)]
pub(crate) struct MspArgs {
    #[command(subcommand)]
    command: MspCommand,
}

#[derive(Debug, Subcommand)]
enum MspCommand {
    /// Print one JSON object per frame; counts of bad frames go to standard error.
    #[command(
        after_help = "Each object: dir (request, response, error), version, framing, cmd, name, payload_hex, fields (wire units in the\n\
        names: _ddeg 0.1 degree, _cm, _dv 0.1 V...); flag when a v2 frame has one, line with --hex, error when the payload does not fit.\n\n\
        Examples:\n  kestrel msp decode capture.bin | jq 'select(.name==\"MSP_ATTITUDE\").fields'\n  cat /dev/ttyUSB0 | kestrel msp decode -\n  \
        kestrel msp decode --hex frames.txt"
    )]
    Decode(DecodeArgs),
    /// Ask a flight controller and print its answers as JSON.
    #[command(
        after_help = "Examples:\n  kestrel msp ask serial:///dev/ttyAMA0?baudrate=115200 MSP_FC_VERSION MSP_ATTITUDE\n  kestrel msp ask tcpclient://127.0.0.1:5761 attitude --count 1000"
    )]
    Ask(AskArgs),
    /// A simulated flight controller on TCP, for client libraries and configurators.
    #[command(
        after_help = "Examples:\n  kestrel msp serve\n  kestrel msp serve tcpserver://127.0.0.1:5762 --serial-rate 1000 --baud 1000000"
    )]
    Serve(ServeArgs),
}

#[derive(Debug, Args)]
struct DecodeArgs {
    /// Bytes of a line, both directions mixed if you like; `-` is standard input.
    #[arg(value_name = "FILE|-")]
    file: PathBuf,
    /// The file is text: one frame or stream a line in hexadecimal.
    #[arg(long)]
    hex: bool,
}

pub(crate) fn run(args: &MspArgs) -> Result<ExitCode> {
    let args = match &args.command {
        MspCommand::Ask(args) => return super::msp_ask::run(args),
        MspCommand::Decode(args) => args,
        MspCommand::Serve(args) => return super::msp_serve::run(args),
    };
    let out = BufWriter::new(std::io::stdout().lock());
    let result = decode(args, out);
    match result {
        // A closed pipe (`| head`) is not an error.
        Err(error) if is_closed_pipe(&error) => Ok(ExitCode::SUCCESS),
        result => result,
    }
}

fn is_closed_pipe(error: &anyhow::Error) -> bool {
    error
        .downcast_ref::<std::io::Error>()
        .is_some_and(|error| error.kind() == ErrorKind::BrokenPipe)
}

fn decode(args: &DecodeArgs, out: impl Write) -> Result<ExitCode> {
    let mut listing = Listing::new(out);
    let input: Box<dyn Read> = if args.file == Path::new("-") {
        Box::new(std::io::stdin().lock())
    } else {
        let file = File::open(&args.file)
            .with_context(|| format!("cannot read {}", args.file.display()))?;
        Box::new(file)
    };
    if args.hex {
        listing.lines(BufReader::new(input))?;
    } else {
        listing.stream(input)?;
    }
    let (text, is_clean) = listing.summary();
    // Counts are no complaint; a closed terminal is no reason to fail.
    let _ = writeln!(std::io::stderr(), "{text}");
    Ok(if is_clean {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

/// Frames to JSON lines, with what was wrong on the way.
struct Listing<W> {
    out: W,
    frames: u64,
    counters: Counters,
    /// Frames whose payload does not fit their command.
    misfits: u64,
    /// Lines that are no hexadecimal numbers.
    bad_lines: u64,
    /// What the last MULTIPLE_MSP request asked: its reply does not say.
    batch: Vec<u8>,
}

impl<W: Write> Listing<W> {
    fn new(out: W) -> Self {
        Self {
            out,
            frames: 0,
            counters: Counters::default(),
            misfits: 0,
            bad_lines: 0,
            batch: Vec::new(),
        }
    }

    /// Raw bytes, written out as they come: the input may be a live line.
    fn stream(&mut self, mut input: impl Read) -> Result<()> {
        let mut decoder = Decoder::new(Accept::Any);
        let mut buffer = [0; 4096];
        loop {
            let count = match input.read(&mut buffer) {
                Ok(0) => break,
                Ok(count) => count,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                Err(error) => return Err(error).context("cannot read on"),
            };
            self.push(&mut decoder, &buffer[..count], None)?;
            self.out.flush()?;
        }
        self.finish(decoder, None)
    }

    /// One frame or stream a line; each begins afresh.
    fn lines(&mut self, input: impl BufRead) -> Result<()> {
        for (index, line) in input.split(b'\n').enumerate() {
            let line = line.context("cannot read on")?;
            let number = index + 1;
            let Some(bytes) = unhex(&line) else {
                self.bad_lines += 1;
                super::term::complain(&format!("line {number} is not hexadecimal"));
                continue;
            };
            let mut decoder = Decoder::new(Accept::Any);
            self.push(&mut decoder, &bytes, Some(number))?;
            self.finish(decoder, Some(number))?;
        }
        Ok(())
    }

    fn push(&mut self, decoder: &mut Decoder, mut bytes: &[u8], line: Option<usize>) -> Result<()> {
        while let Some(frame) = decoder.decode(&mut bytes) {
            self.frame(&frame, line)?;
        }
        Ok(())
    }

    /// Nothing more comes: a frame without its end is given up, what it swallowed is looked at.
    fn finish(&mut self, mut decoder: Decoder, line: Option<usize>) -> Result<()> {
        while decoder.has_partial() {
            decoder.resync();
            self.push(&mut decoder, &[], line)?;
        }
        let (sum, more) = (&mut self.counters, decoder.counters());
        sum.frames += more.frames;
        sum.checksum += more.checksum;
        sum.oversize += more.oversize;
        sum.malformed += more.malformed;
        sum.truncated += more.truncated;
        sum.noise_bytes += more.noise_bytes;
        self.out.flush()?;
        Ok(())
    }

    fn frame(&mut self, frame: &Frame<'_>, line: Option<usize>) -> Result<()> {
        self.frames += 1;
        let mut object = Map::new();
        if let Some(line) = line {
            object.insert("line".into(), line.into());
        }
        object.insert("dir".into(), dir(frame.direction).into());
        object.insert("version".into(), version(frame.framing).into());
        object.insert("framing".into(), framing(frame).into());
        object.insert("cmd".into(), frame.command.into());
        object.insert("name".into(), command::name(frame.command).into());
        if frame.flag != 0 {
            object.insert("flag".into(), frame.flag.into());
        }
        object.insert("payload_hex".into(), hex(frame.payload).into());
        let fields = self.fields(frame);
        if let Err(error) = &fields {
            self.misfits += 1;
            object.insert("error".into(), error.to_string().into());
        }
        object.insert("fields".into(), fields.unwrap_or(Value::Null));
        serde_json::to_writer(&mut self.out, &object)?;
        self.out.write_all(b"\n")?;
        Ok(())
    }

    fn fields(&mut self, frame: &Frame<'_>) -> Result<Value, ParseError> {
        match frame.direction {
            Direction::Error => Ok(json!({})),
            Direction::Reply if frame.command == command::MULTIPLE_MSP => {
                let mut replies = Replies::new(&self.batch, frame.payload);
                let parts: Result<Vec<Value>, ParseError> = replies
                    .by_ref()
                    .map(|(number, payload)| {
                        let fields = reply_fields(number, payload)?;
                        Ok(json!({"cmd": number, "name": command::name(number), "fields": fields}))
                    })
                    .collect();
                Ok(json!({"replies": parts?, "unanswered": replies.unanswered()}))
            }
            Direction::Reply => reply_fields(frame.command, frame.payload),
            Direction::Request => {
                let order = Order::parse(frame.command, frame.payload)?;
                if let Order::Multiple(batch) = &order {
                    self.batch = batch.commands.to_vec();
                }
                Ok(match order {
                    // The payload stands beside it already.
                    Order::Query { .. } | Order::Other(_) => json!({}),
                    order => json!(order),
                })
            }
        }
    }

    /// One line for standard error, and whether the input was what it should be.
    fn summary(&self) -> (String, bool) {
        let c = &self.counters;
        let mut text = format!(
            "{} frames; bad: {} checksum, {} oversize, {} malformed, {} truncated; {} bytes of noise",
            self.frames, c.checksum, c.oversize, c.malformed, c.truncated, c.noise_bytes
        );
        if self.misfits > 0 {
            text += &format!("; {} payloads that do not fit their command", self.misfits);
        }
        if self.bad_lines > 0 {
            text += &format!("; {} lines that are not hexadecimal", self.bad_lines);
        }
        (text, self.bad_lines == 0)
    }
}

pub(super) fn reply_fields(number: u16, payload: &[u8]) -> Result<Value, ParseError> {
    Ok(match Reply::parse(number, payload)? {
        Reply::Ack { .. } | Reply::Other(_) => json!({}),
        reply => json!(reply),
    })
}

const fn dir(direction: Direction) -> &'static str {
    match direction {
        Direction::Error => "error",
        Direction::Reply => "response",
        Direction::Request => "request",
    }
}

const fn version(framing: Framing) -> &'static str {
    match framing {
        Framing::V1 => "v1",
        Framing::V2 => "v2",
        Framing::V2OverV1 => "v2-over-v1",
    }
}

/// As [`version`], and whether a v1 frame has the long form.
fn framing(frame: &Frame<'_>) -> &'static str {
    if frame.framing == Framing::V1 && frame.payload.len() > 254 {
        "v1-jumbo"
    } else {
        version(frame.framing)
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Bytes of a line of hexadecimal digits; blanks, colons, commas and `0x` may stand between them.
fn unhex(line: &[u8]) -> Option<Vec<u8>> {
    let text = str::from_utf8(line).ok()?.replace("0x", " ");
    let digits: Option<Vec<u8>> = text
        .chars()
        .filter(|c| !c.is_whitespace() && !matches!(c, ':' | ','))
        .map(|c| c.to_digit(16).and_then(|digit| u8::try_from(digit).ok()))
        .collect();
    let digits = digits?;
    let (pairs, rest) = digits.as_chunks::<2>();
    rest.is_empty()
        .then(|| pairs.iter().map(|[high, low]| high << 4 | low).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn listing(lines: &str) -> (Vec<Value>, String) {
        let mut listing = Listing::new(Vec::new());
        listing.lines(lines.as_bytes()).unwrap();
        let summary = listing.summary().0;
        let text = String::from_utf8(listing.out).unwrap();
        let objects = text.lines().map(|line| serde_json::from_str(line).unwrap());
        (objects.collect(), summary)
    }

    #[test]
    fn a_frame_becomes_an_object_with_wire_units_in_its_names() {
        let (objects, summary) = listing("244d3e066c85ff2d000e0132\n");
        assert_eq!(
            objects,
            [
                json!({"line": 1, "dir": "response", "version": "v1", "framing": "v1", "cmd": 108, "name": "MSP_ATTITUDE",
                "payload_hex": "85ff2d000e01", "fields": {"roll_ddeg": -123, "pitch_ddeg": 45, "yaw_deg": 270}})
            ]
        );
        assert!(
            summary.starts_with("1 frames; bad: 0 checksum"),
            "{summary}"
        );
    }

    #[test]
    fn a_batch_is_taken_apart_with_the_request_before_it() {
        // MULTIPLE_MSP(108, 109), then both answers.
        let (objects, _) = listing(
            "24 4d 3c 02 e6 6c 6d e5, 0x24 4d 3e 0e e6 06 01 00 02 00 03 00 06 0a 00 00 00 00 00 e2",
        );
        assert_eq!(objects[0]["fields"]["commands"], json!([108, 109]));
        let replies = &objects[1]["fields"]["replies"];
        assert_eq!(replies[0]["fields"]["yaw_deg"], 3, "{objects:?}");
        assert_eq!(replies[1]["fields"]["altitude_cm"], 10);
    }

    #[test]
    fn bad_frames_are_counted_and_good_ones_after_them_found() {
        let (objects, summary) =
            listing("244d3e066c85ff2d000e0167244d3e066c85ff2d000e0132\n244d3ef06c");
        assert_eq!(objects.len(), 1);
        assert!(
            summary.contains("1 checksum") && summary.contains("1 truncated"),
            "{summary}"
        );
    }

    #[test]
    fn a_line_that_is_no_number_is_named() {
        let (objects, summary) = listing("hello\n244d3c006c6c\n");
        assert_eq!((objects.len(), &objects[0]["dir"]), (1, &json!("request")));
        assert!(
            summary.ends_with("1 lines that are not hexadecimal"),
            "{summary}"
        );
    }

    #[test]
    fn a_payload_that_does_not_fit_has_an_error_and_no_fields() {
        let (objects, summary) = listing("244d3e026c01006f");
        assert_eq!(objects[0]["fields"], Value::Null);
        assert!(
            objects[0]["error"]
                .as_str()
                .unwrap()
                .contains("needs at least 4 bytes"),
            "{objects:?}"
        );
        assert!(summary.contains("1 payloads"), "{summary}");
    }
}
