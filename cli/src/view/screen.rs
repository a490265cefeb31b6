//! Drawing of the model: header, horizon, figures and health, strips, messages, keys.

use ratatui::buffer::Buffer;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style};

use super::dots::{ACROSS, DOWN, Dots};
use super::letters::{number, put};
use super::model::{Connection, Model, STRIP_S, Speaker, Trust};
use super::{compass, horizon, keys};
use crate::stream::Attitude;

/// Smallest terminal that holds all parts.
const LEAST: (u16, u16) = (80, 24);
/// Height from which on the figures have empty rows between them.
const TALL: u16 = 17;

pub const ROLL: Color = Color::Indexed(208);
pub const PITCH: Color = Color::Indexed(45);
pub const YAW: Color = Color::Indexed(141);
const COLOURS: [Color; 3] = [ROLL, PITCH, YAW];
const FAINT: Color = Color::Indexed(244);
const TEXT: Color = Color::Indexed(252);
const BAR: Color = Color::Indexed(237);
const GOOD: Color = Color::Indexed(28);
const BAD: Color = Color::Indexed(160);
const CAUTION: Color = Color::Indexed(136);
const NEUTRAL: Color = Color::Indexed(240);
const WHITE: Color = Color::Indexed(231);

/// Possible ends of a strip's scale, degrees.
const ANGLES: [f64; 8] = [5.0, 10.0, 20.0, 30.0, 45.0, 60.0, 90.0, 180.0];
/// Possible ends of a strip's scale, °/s, up to the sensor's largest full scale.
const RATES: [f64; 9] = [5.0, 10.0, 20.0, 50.0, 100.0, 250.0, 500.0, 1000.0, 2000.0];

/// Draws everything.
pub fn draw(model: &Model, area: Rect, buffer: &mut Buffer) {
    if area.width < LEAST.0 || area.height < LEAST.1 {
        let text = format!("{} columns and {} rows are needed", LEAST.0, LEAST.1);
        put(buffer, area, 0, 0, &text, Style::new());
        return;
    }
    // All parts share the rows of a larger terminal.
    let more = area.height - LEAST.1;
    let [header, top, strips, messages, footer] = Layout::vertical([
        Constraint::Length(1),
        Constraint::Fill(1),
        Constraint::Length(6 + more * 5 / 16),
        Constraint::Length(4 + more / 8),
        Constraint::Length(1),
    ])
    .areas(area);
    let [left, _, right] = Layout::horizontal([
        Constraint::Fill(1),
        Constraint::Length(1),
        Constraint::Length((area.width * 2 / 5).clamp(32, 44)),
    ])
    .areas(top);
    draw_header(model, header, buffer);
    draw_horizon(model, left, buffer);
    draw_figures(model, right, buffer);
    draw_compass(model, left, right, buffer);
    let [angles, _, rates] = Layout::horizontal([
        Constraint::Fill(1),
        Constraint::Length(1),
        Constraint::Fill(1),
    ])
    .areas(strips);
    let strip = Strip {
        names: &["roll", "pitch"],
        unit: "degrees",
        scales: &ANGLES,
        values: |attitude| [Some(attitude.roll_deg), Some(attitude.pitch_deg), None],
    };
    draw_strip(model, &strip, angles, buffer);
    let strip = Strip {
        names: &["roll", "pitch", "yaw rate"],
        unit: "°/s",
        scales: &RATES,
        values: |attitude| attitude.rates_deg_s,
    };
    draw_strip(model, &strip, rates, buffer);
    draw_messages(model, messages, buffer);
    draw_footer(model, footer, buffer);
    if model.shows_help {
        draw_help(model, area, buffer);
    }
}

/// Writes a text at the right end of a row.
fn put_right(buffer: &mut Buffer, area: Rect, y: u16, text: &str, style: Style) {
    let width = text.chars().count() as u16;
    put(
        buffer,
        area,
        area.width.saturating_sub(width),
        y,
        text,
        style,
    );
}

fn draw_header(model: &Model, area: Rect, buffer: &mut Buffer) {
    let bar = Style::new().bg(BAR).fg(TEXT);
    buffer.set_style(area, bar);
    let bold = bar.add_modifier(Modifier::BOLD);
    let mut x = put(buffer, area, 1, 0, "aplomb ", bold.fg(WHITE));
    let name_room = usize::from(area.width) - 56;
    let name: String = match model.name.char_indices().nth_back(name_room) {
        // A long path loses its beginning.
        Some((start, letter)) => format!("…{}", &model.name[start + letter.len_utf8()..]),
        None => model.name.clone(),
    };
    x = put(buffer, area, x, 0, &name, bar);
    let (text, style) = match &model.connection {
        Connection::Open(Some(baud)) => (format!(" {baud} baud"), bar),
        Connection::Open(None) => (String::new(), bar),
        Connection::Away(_) => (" UNPLUGGED".into(), bold.bg(BAD).fg(WHITE)),
        Connection::Ended(_) => (" ENDED".into(), bold.bg(BAD).fg(WHITE)),
        Connection::Playing { speed, is_over } => {
            let end = if *is_over { ", at its end" } else { "" };
            (format!(" at {:.1} s, ×{speed}{end}", model.now_s), bar)
        }
    };
    x = put(buffer, area, x, 0, &text, style);
    if let Some(format) = model.format {
        x = put(
            buffer,
            area,
            x,
            0,
            &format!(" · {}", format.name()),
            bar.fg(WHITE),
        );
    }
    if model.is_paused {
        put(
            buffer,
            area,
            x + 1,
            0,
            " PAUSED ",
            bold.bg(CAUTION).fg(WHITE),
        );
    }
    if let Some((file, bytes)) = &model.recording {
        let text = format!(" ● {file} {} ", size(*bytes));
        put_right(buffer, area, 0, &text, bold.bg(BAD).fg(WHITE));
    }
}

fn size(bytes: u64) -> String {
    if bytes < 1_000_000 {
        format!("{:.1} kB", bytes as f64 / 1e3)
    } else {
        format!("{:.1} MB", bytes as f64 / 1e6)
    }
}

fn draw_horizon(model: &Model, area: Rect, buffer: &mut Buffer) {
    let attitude = model
        .attitude()
        .map(|attitude| (f64::from(attitude.roll_deg), f64::from(attitude.pitch_deg)));
    horizon::draw(attitude, area, buffer);
    let trust = model.trust();
    if attitude.is_none() || matches!(trust, Trust::NotValid(_)) {
        let text = match trust {
            Trust::NoData(_) => "  NO ATTITUDE  ",
            _ => "  NOT VALID  ",
        };
        let style = Style::new().bg(BAD).fg(WHITE).add_modifier(Modifier::BOLD);
        let x = (area.width - text.len() as u16) / 2;
        put(buffer, area, x, area.height * 3 / 4, text, style);
    }
}

/// Draws the compass over the horizon, and in the free row below the angles.
fn draw_compass(model: &Model, horizon: Rect, figures: Rect, buffer: &mut Buffer) {
    if let Some(heading) = model.heading() {
        compass::draw_tape(&heading, model.field, horizon, buffer);
        let row = if figures.height >= TALL { 6 } else { 3 };
        compass::draw_heading(&heading, figures, row, buffer);
    }
}

fn draw_figures(model: &Model, area: Rect, buffer: &mut Buffer) {
    let attitude = model.attitude();
    let (plain, faint) = (Style::new().fg(TEXT), Style::new().fg(FAINT));
    // A tall area has empty rows between the figures and around the banner.
    let (step, tall) = if area.height >= TALL { (2, 5) } else { (1, 3) };
    for (index, (name, colour)) in ["roll", "pitch", "yaw"]
        .into_iter()
        .zip(COLOURS)
        .enumerate()
    {
        let row = step * index as u16;
        let bold = Style::new().fg(colour).add_modifier(Modifier::BOLD);
        put(buffer, area, 0, row, name, bold);
        let angle = attitude.and_then(|attitude| match index {
            0 => Some(attitude.roll_deg),
            1 => Some(attitude.pitch_deg),
            _ => attitude.yaw_deg,
        });
        let rate = attitude.and_then(|attitude| attitude.rates_deg_s[index]);
        put(buffer, area, 6, row, &number(angle, 8, "°"), bold);
        put(buffer, area, 17, row, &number(rate, 8, " °/s"), plain);
    }
    let (text, colour) = match model.trust() {
        Trust::Valid => ("VALID".to_owned(), GOOD),
        Trust::Healthy => ("SENSORS HEALTHY".to_owned(), GOOD),
        Trust::Unhealthy(_) => ("SENSOR UNHEALTHY".to_owned(), CAUTION),
        Trust::NotValid(_) => ("NOT VALID".to_owned(), BAD),
        Trust::Unknown => ("health is not in this format".to_owned(), NEUTRAL),
        Trust::NoData(None) => ("NO ATTITUDE YET".to_owned(), CAUTION),
        Trust::NoData(Some(seconds)) => (format!("NO ATTITUDE FOR {seconds:.0} s"), BAD),
    };
    let banner_row = 3 * step + 1;
    let banner = Rect {
        y: area.y + banner_row,
        height: tall,
        ..area
    };
    let style = Style::new()
        .bg(colour)
        .fg(WHITE)
        .add_modifier(Modifier::BOLD);
    buffer.set_style(banner, style);
    let x = (banner.width.saturating_sub(text.chars().count() as u16)) / 2;
    put(buffer, banner, x, tall / 2, &text, style);
    // Names of flags, as many to a row as fit; two rows at least.
    let names = match model.trust() {
        Trust::NotValid(names) | Trust::Unhealthy(names) => names,
        _ => model.flag_names(),
    };
    let last_row = area.height - 3;
    let (mut x, mut y) = (0, banner_row + tall);
    for name in names {
        let length = name.len() as u16;
        if x > 0 && x + length > area.width {
            (x, y) = (0, y + 1);
        }
        if y > last_row {
            break;
        }
        let style = Style::new()
            .fg(colour_of(name))
            .add_modifier(Modifier::BOLD);
        x = put(buffer, area, x, y, name, style) + 1;
    }
    // Old values are not shown.
    let sigma = model
        .tilt_sigma_deg
        .filter(|sigma| sigma.is_finite() && attitude.is_some());
    let sigma = number(sigma, 0, "°");
    let temperature = match model.temperature_c.filter(|_| attitude.is_some()) {
        Some(celsius) => format!("{celsius:.1} °C"),
        None => "-".into(),
    };
    let y = area.height - 2;
    let x = put(buffer, area, 0, y, "tilt σ ", faint);
    put(buffer, area, x, y, &sigma, plain);
    let x = put(buffer, area, 17, y, "chip ", faint);
    put(buffer, area, x, y, &temperature, plain);
    draw_counts(model, area, y + 1, buffer);
}

/// Returns the colour of a flag: red if it invalidates the attitude.
fn colour_of(name: &str) -> Color {
    use aplomb::health::Flags;
    match Flags::from_name(name) {
        Some(flag) if !Flags::INVALIDATING.contains(flag) => Color::Indexed(214),
        _ => Color::Indexed(203),
    }
}

/// Draws the rates and the counts of losses in a row. A narrow row leaves out the rates first, so
/// that no count is cut.
fn draw_counts(model: &Model, area: Rect, y: u16, buffer: &mut Buffer) {
    let (plain, faint) = (Style::new().fg(TEXT), Style::new().fg(FAINT));
    let bad = Style::new()
        .fg(Color::Indexed(203))
        .add_modifier(Modifier::BOLD);
    let (hertz, bursts_hertz) = match model.rates_hz() {
        Some((hertz, bursts)) => (format!("{hertz:.0}"), (bursts > 0.0).then_some(bursts)),
        None => ("-".into(), None),
    };
    let mut rates = vec![(hertz, plain), ("/s ".to_owned(), faint)];
    if let Some(bursts) = bursts_hertz {
        rates.extend([
            (format!("{bursts:.0}"), plain),
            (" samples/s ".to_owned(), faint),
        ]);
    }
    let losses = [
        ("lost", model.counts.lost),
        ("bad", model.counts.damaged),
        ("dropped", model.frames_dropped.unwrap_or_default()),
        ("failed", model.bursts_failed.unwrap_or_default()),
    ];
    let shown = losses
        .into_iter()
        .filter(|(name, count)| *count > 0 || *name == "lost");
    let losses: Vec<_> = shown
        .flat_map(|(name, count)| {
            let style = if count > 0 { bad } else { plain };
            [(format!("{name} "), faint), (short(count) + " ", style)]
        })
        .collect();
    let length = |words: &[(String, Style)]| -> usize {
        words.iter().map(|(word, _)| word.chars().count()).sum()
    };
    // The last space may be cut.
    let room = usize::from(area.width) + 1;
    let mut x = 0;
    if length(&rates) + length(&losses) <= room {
        for (word, style) in &rates {
            x = put(buffer, area, x, y, word, *style);
        }
    }
    for pair in losses.chunks(2) {
        if usize::from(x) + length(pair) > room {
            put(buffer, area, area.width - 1, y, "…", bad);
            return;
        }
        for (word, style) in pair {
            x = put(buffer, area, x, y, word, *style);
        }
    }
}

/// Formats a count in at most five letters: thousands and millions with their sign.
fn short(count: u64) -> String {
    match count {
        0..10_000 => count.to_string(),
        10_000..10_000_000 => format!("{}k", count / 1_000),
        10_000_000.. => format!("{}M", (count / 1_000_000).min(9_999)),
    }
}

/// Contents of a strip.
struct Strip {
    names: &'static [&'static str],
    unit: &'static str,
    scales: &'static [f64],
    values: fn(&Attitude) -> [Option<f32>; 3],
}

fn draw_strip(model: &Model, strip: &Strip, area: Rect, buffer: &mut Buffer) {
    let Strip {
        names,
        unit,
        scales,
        values,
    } = *strip;
    let faint = Style::new().fg(FAINT);
    let title = Rect { height: 1, ..area };
    put(
        buffer,
        title,
        0,
        0,
        &"─".repeat(area.width.into()),
        Style::new().fg(BAR),
    );
    let mut x = 1;
    for (name, colour) in names.iter().zip(COLOURS) {
        let style = Style::new().fg(colour).add_modifier(Modifier::BOLD);
        x = put(buffer, title, x, 0, &format!(" {name}"), style);
    }
    put(buffer, title, x, 0, &format!(" in {unit} "), faint);
    put_right(buffer, title, 0, &format!(" {STRIP_S:.0} s "), faint);
    let [scale_area, plot] = Layout::horizontal([Constraint::Length(5), Constraint::Fill(1)])
        .areas(Rect {
            y: area.y + 1,
            height: area.height - 1,
            ..area
        });
    let largest = model
        .points
        .iter()
        .flat_map(|point| values(&point.attitude))
        .flatten()
        .map(|value| f64::from(value.abs()))
        .fold(0.0, f64::max);
    let fitting = scales.iter().find(|scale| **scale >= largest);
    let scale = *fitting.unwrap_or(&scales[scales.len() - 1]);
    put_right(
        buffer,
        Rect {
            width: 4,
            ..scale_area
        },
        0,
        &format!("{scale:.0}"),
        faint,
    );
    let low = format!("{:.0}", -scale);
    put_right(
        buffer,
        Rect {
            width: 4,
            ..scale_area
        },
        scale_area.height - 1,
        &low,
        faint,
    );
    draw_curves(model, values, scale, plot, buffer);
}

/// Draws the curves of a strip over the last [`STRIP_S`].
fn draw_curves(
    model: &Model,
    values: fn(&Attitude) -> [Option<f32>; 3],
    scale: f64,
    plot: Rect,
    buffer: &mut Buffer,
) {
    let width = f64::from(i32::from(plot.width) * ACROSS);
    let height = f64::from(i32::from(plot.height) * DOWN);
    let mut dots = Dots::new(plot);
    for x in (0..i32::from(plot.width) * ACROSS).step_by(4) {
        dots.set(x, (height / 2.0) as i32, NEUTRAL);
    }
    for (index, colour) in COLOURS.into_iter().enumerate().rev() {
        let mut last: Option<(f64, f64)> = None;
        for point in &model.points {
            let Some(value) = values(&point.attitude)[index] else {
                last = None;
                continue;
            };
            let age_s = model.now_s - point.at_s;
            let share = (f64::from(value) / scale).clamp(-1.0, 1.0);
            let place = (
                width - 1.0 - age_s / STRIP_S * width,
                (height - 1.0) * (0.5 - 0.5 * share) + 0.5,
            );
            // Across a wrap from 180 to −180, or a gap, there is no line.
            let start = last.filter(|(x, y)| {
                (y - place.1).abs() < height * 0.6 && place.0 - x < width / STRIP_S
            });
            // A value on the present point adds nothing.
            if start.is_none_or(|(x, y)| x.floor() != place.0.floor() || (y - place.1).abs() >= 1.0)
            {
                dots.line(start.unwrap_or(place), place, colour);
                last = Some(place);
            }
        }
    }
    dots.draw(buffer, |_| true);
}

fn draw_messages(model: &Model, area: Rect, buffer: &mut Buffer) {
    let faint = Style::new().fg(FAINT);
    put(
        buffer,
        area,
        0,
        0,
        &"─".repeat(area.width.into()),
        Style::new().fg(BAR),
    );
    put(buffer, area, 1, 0, " messages ", faint);
    let rows = usize::from(area.height - 1);
    // Long messages take several rows; the newest is at the bottom.
    let mut lines: Vec<(String, Style)> = Vec::new();
    for message in model.messages.iter().rev() {
        let style = match message.speaker {
            Speaker::Person => Style::new().fg(PITCH),
            Speaker::Program => Style::new().fg(Color::Indexed(214)),
            Speaker::Module if is_bad(&message.text) => Style::new().fg(Color::Indexed(203)),
            Speaker::Module => Style::new().fg(TEXT),
        };
        let sign = if message.speaker == Speaker::Person {
            "> "
        } else {
            ""
        };
        let text = format!("{:7.1}  {sign}{}", message.at_s, message.text);
        let mut parts = wrapped(&text, usize::from(area.width), 9);
        parts.reverse();
        lines.extend(parts.into_iter().map(|part| (part, style)));
        if lines.len() >= rows {
            break;
        }
    }
    lines.truncate(rows);
    for (row, (text, style)) in (1..).zip(lines.iter().rev()) {
        put(buffer, area, 0, row, text, *style);
    }
}

/// Returns whether the module reports a fault.
fn is_bad(text: &str) -> bool {
    ["error", "failed"]
        .iter()
        .any(|word| text.starts_with(word))
        || text.contains("lost")
        || text.contains("trying again")
}

/// Wraps a text at spaces into rows of at most `width` letters. All rows but the first are
/// indented.
fn wrapped(text: &str, width: usize, indent: usize) -> Vec<String> {
    let mut rows = Vec::new();
    let mut row = String::new();
    for word in text.split_inclusive(' ') {
        let has_more = row.trim().chars().count() > 0;
        if has_more && row.chars().count() + word.trim_end().chars().count() > width {
            rows.push(row.trim_end().to_owned());
            row = " ".repeat(indent);
        }
        row.push_str(word);
    }
    rows.push(row.trim_end().to_owned());
    rows
}

fn draw_footer(model: &Model, area: Rect, buffer: &mut Buffer) {
    let bar = Style::new().bg(BAR).fg(TEXT);
    buffer.set_style(area, bar);
    let bold = bar.fg(WHITE).add_modifier(Modifier::BOLD);
    if let Some(typed) = &model.typed {
        let x = put(buffer, area, 1, 0, ":", bold);
        let x = put(buffer, area, x, 0, typed, bold);
        let x = put(buffer, area, x, 0, "█", bold);
        put(
            buffer,
            area,
            x + 2,
            0,
            "enter sends it, escape does not",
            bar.fg(FAINT),
        );
        return;
    }
    let mut x = 1;
    for (key, what) in keys::summary(model.is_playing()) {
        x = put(buffer, area, x, 0, key, bold);
        x = put(buffer, area, x, 0, &format!(" {what} "), bar);
    }
}

fn draw_help(model: &Model, area: Rect, buffer: &mut Buffer) {
    let lines = keys::help(model.is_playing());
    let width = 66.min(area.width);
    let height = (lines.len() as u16 + 2).min(area.height);
    let place = Rect {
        x: area.x + (area.width - width) / 2,
        y: area.y + (area.height - height) / 2,
        width,
        height,
    };
    for cell in place.positions() {
        if let Some(cell) = buffer.cell_mut(cell) {
            cell.set_symbol(" ").set_fg(TEXT).set_bg(BAR);
        }
    }
    let bar = Style::new().fg(TEXT).bg(BAR);
    for (row, (key, what)) in (1..).zip(&lines) {
        let bold = bar.fg(WHITE).add_modifier(Modifier::BOLD);
        put(buffer, place, 2, row, key, bold);
        put(buffer, place, 9, row, what, bar);
    }
}
