//! `mav keys` and `mav watch`: what goes on until somebody says stop.

use super::super::Usage;
use super::client::Client;
use anyhow::{Result, bail};
use bridge::settings::nearest;
use mavlink::Message as _;
use mavlink_dialect::command::cmd;
use mavlink_dialect::{Message, raw, standard};
use rustix::termios::{self, LocalModes, OptionalActions, Termios};
use std::io::{IsTerminal as _, Read as _, Write as _, stdin, stdout};
use std::sync::mpsc::{Receiver, TryRecvError, sync_channel};

/// SERIAL_CONTROL: the shell, a reply, an answer wanted, several of them.
const SHELL: u8 = 10;
const REPLY: u8 = 1;
const RESPOND_MULTI: u8 = 2 | 16;
const END_OF_TEXT: u8 = 3;
const END_OF_TRANSMISSION: u8 = 4;

/// To standard output; a closed pipe (`| head`) is not an error.
pub(super) fn print(text: &str) -> Result<()> {
    let _ = stdout().write_all(text.as_bytes());
    Ok(())
}

/// The terminal as it was, given back at the end.
struct Keyboard {
    before: Option<Termios>,
}

impl Keyboard {
    /// Keys without ENTER, if it is a terminal.
    fn open() -> Self {
        let before = stdin()
            .is_terminal()
            .then(|| termios::tcgetattr(stdin()).ok())
            .flatten();
        if let Some(before) = &before {
            let mut now = before.clone();
            now.local_modes
                .remove(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG);
            let _ = termios::tcsetattr(stdin(), OptionalActions::Now, &now);
        }
        Self { before }
    }
}

impl Drop for Keyboard {
    fn drop(&mut self) {
        if let Some(before) = &self.before {
            let _ = termios::tcsetattr(stdin(), OptionalActions::Now, before);
        }
    }
}

/// Bytes of the keyboard, read where waiting hurts nobody.
fn typed() -> Receiver<u8> {
    let (send, receive) = sync_channel(256);
    std::thread::spawn(move || {
        let mut byte = [0u8];
        while let Ok(1) = stdin().read(&mut byte) {
            if send.send(byte[0]).is_err() {
                break;
            }
        }
    });
    receive
}

pub(super) fn keys(client: &mut Client) -> Result<()> {
    let keyboard = Keyboard::open();
    let is_terminal = keyboard.before.is_some();
    let typed = typed();
    let mut line = Vec::new();
    let mut is_word = false;
    // What was typed last, and how long after its end answers are still waited for.
    let mut ended_at = None;
    if is_terminal {
        print("keys go out at once; `:` begins a word (`:help`), Ctrl-D ends\n")?;
    }
    loop {
        loop {
            match typed.try_recv() {
                Ok(END_OF_TEXT | END_OF_TRANSMISSION) if is_terminal => return Ok(()),
                // At a terminal a lone letter is a key; a word is begun by a colon.
                Ok(b':') if is_terminal && line.is_empty() => is_word = true,
                Ok(byte) if is_terminal && !is_word => {
                    send_line(client, &[byte]);
                }
                Ok(b'\r' | b'\n') => {
                    send_line(client, &line);
                    line.clear();
                    is_word = false;
                }
                Ok(byte) => line.push(byte),
                Err(TryRecvError::Empty) => break,
                Err(TryRecvError::Disconnected) => {
                    if !line.is_empty() {
                        send_line(client, &line);
                        line.clear();
                    }
                    ended_at = ended_at.or_else(|| Some(client.within(1.0)));
                    break;
                }
            }
        }
        if ended_at.is_some_and(|at| client.now() >= at) {
            return Ok(());
        }
        let until = client.within(0.05);
        while let Some(frame) = client.next(until) {
            if let Message::Raw(raw::MavMessage::SERIAL_CONTROL(m)) = &frame.message
                && m.device == SHELL
                && m.flags & REPLY != 0
                && m.target_system == client.us.system
            {
                let bytes = &m.data[..usize::from(m.count).min(m.data.len())];
                let _ = stdout().write_all(bytes);
                let _ = stdout().flush();
            }
        }
    }
}

fn send_line(client: &mut Client, line: &[u8]) {
    let mut line = line.to_vec();
    line.push(b'\n');
    for piece in line.chunks(70) {
        let mut data = [0u8; 70];
        data[..piece.len()].copy_from_slice(piece);
        client.send(raw::MavMessage::SERIAL_CONTROL(raw::SERIAL_CONTROL_DATA {
            device: SHELL,
            flags: RESPOND_MULTI,
            count: piece.len() as u8,
            data,
            target_system: client.vehicle.system,
            target_component: client.vehicle.component,
            ..Default::default()
        }));
    }
}

/// Id of a message by its name.
fn id_of(name: &str) -> Result<u32> {
    let ours = raw::MavMessage::all_ids().iter().filter_map(|id| {
        Some((
            *id,
            raw::MavMessage::default_message_from_id(*id)?.message_name(),
        ))
    });
    let theirs = standard::MavMessage::all_ids().iter().filter_map(|id| {
        Some((
            *id,
            standard::MavMessage::default_message_from_id(*id)?.message_name(),
        ))
    });
    let all: Vec<(u32, &str)> = ours.chain(theirs).collect();
    match all.iter().find(|(_, n)| n.eq_ignore_ascii_case(name)) {
        Some((id, _)) => Ok(*id),
        None => {
            let near = nearest(&name.to_ascii_uppercase(), all.iter().map(|(_, n)| *n));
            let hint = near
                .map(|n| format!("; did you mean `{n}`?"))
                .unwrap_or_default();
            Err(Usage(format!("no message `{name}`{hint}")).into())
        }
    }
}

pub(super) fn watch(
    client: &mut Client,
    names: &[String],
    hz: Option<f64>,
    count: Option<u64>,
) -> Result<()> {
    let ids: Vec<u32> = names.iter().map(|n| id_of(n)).collect::<Result<_>>()?;
    if let Some(hz) = hz {
        if !(0.01..=500.0).contains(&hz) {
            return Err(Usage("--hz: 0.01 to 500".to_owned()).into());
        }
        for id in &ids {
            client.command(
                "rate",
                raw::COMMAND_INT_DATA {
                    command: cmd::SET_MESSAGE_INTERVAL,
                    param1: *id as f32,
                    param2: (1e6 / hz) as f32,
                    ..Default::default()
                },
            )?;
        }
    }
    let mut left = count.unwrap_or(u64::MAX);
    while left > 0 {
        let until = client.within(5.0);
        let Some(frame) = client.next(until) else {
            bail!("nothing came for 5 s");
        };
        let is_wanted = ids.is_empty() || ids.contains(&frame.message.id());
        if frame.from.system != client.vehicle.system || !is_wanted {
            continue;
        }
        let fields = match &frame.message {
            Message::Raw(m) => format!("{m:?}"),
            Message::Standard(m) => format!("{m:?}"),
        };
        if writeln!(stdout(), "{:.3} {} {fields}", client.now().s(), frame.from).is_err() {
            return Ok(());
        }
        left -= 1;
    }
    Ok(())
}
