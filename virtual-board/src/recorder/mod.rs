//! The recorder of a run: every published snapshot with its cause and its cost, the log, the UART.
//!
//! The emulator calls [`Recorder`] after every access to a peripheral and whenever it stops, with
//! the firmware between two instructions. Recording does not change the run, except that the probe,
//! if there is one, empties the log buffer.

mod memory;
mod record;
mod timer;

use std::sync::{Arc, Mutex};
use std::time::Instant;

use aplomb::fault::{FaultClass, report};
use aplomb::health::{Flags, STACK_PATTERN};
use aplomb::pipeline::Snapshot;
use aplomb_models::sensor::Burst;
use rigless::emulator::{AccessKind, Driver, Hit, Host, Memory, Settled, Stop, Watch};
use rigless::session::Session;
use rigless::soc::Width;
use rigless::soc::stm32f427::generated::{FLASH, TIM5};
use rigless::time::VirtualNanos;

pub use record::{HealthReading, Record, Sample, StaleSnapshot};

use crate::board::Board;
use crate::faults::{FaultKind, ScheduledFault};
use crate::image::Firmware;
use crate::mcu::ReceivedByte;
use crate::probe::{LogLine, Probe};
use crate::profile::{Counts, EXCEPTIONS, Profile, Upset, exception_of};
use crate::ram::Ram;
use memory::{is_armed, read_heading, read_snapshot};
use timer::Timer;

/// Offset of the count in the published structure; the snapshot is at 0.
const SEQUENCE: u64 = 44;

/// Period with which the probe empties the log, in virtual time.
const SERVICE_PERIOD_NS: u64 = 1_000_000;

/// The interrupt that the firmware runs its attitude task on: SPI3 (`src/bin/flight/main.rs`;
/// RM0090, table 62).
const ATTITUDE_INTERRUPT: u16 = 51;

/// An NMI handler that has not cleared its cause after this time never will, ns. The firmware's
/// handler is two stores.
const NMI_LIMIT_NS: u64 = 20_000;

/// The interrupts that only the sample path uses (RM0090, table 62): DMA1 stream 0, EXTI1, I2C1
/// events and errors, TIM5. SPI1's is the one that reads the settings back.
const INPUT_INTERRUPTS: [usize; 6] = [11, 7, 31, 32, 50, 35];

/// The progress of the run, reported about ten times a second of real time.
#[derive(Clone, Copy, Debug)]
pub struct Progress {
    /// Virtual time passed, ns.
    pub now_ns: u64,
    /// Virtual time at which the run ends, ns.
    pub end_ns: u64,
}

/// An observer of the run while it goes on.
pub trait Observer: Send {
    /// The firmware has logged a line.
    fn log(&mut self, _line: &LogLine) {}

    /// Time has passed.
    fn progress(&mut self, _progress: Progress) {}

    /// Takes the bytes from the UART since the last call, and returns bytes to send to it. Called
    /// every millisecond of virtual time.
    fn uart(&mut self, _now_ns: u64, _received: &[ReceivedByte]) -> Vec<u8> {
        Vec::new()
    }

    /// Returns true if the record of the run is kept. A run without end keeps none.
    fn keeps_record(&self) -> bool {
        true
    }
}

/// An observer that ignores the run.
pub struct NoObserver;

impl Observer for NoObserver {}

/// Records a run.
pub struct Recorder {
    end_ns: u64,
    snapshot: Option<u64>,
    /// Address of the published heading, if there is one.
    heading: Option<u64>,
    /// Address of the firmware's report of its health, if it has one.
    health: Option<u64>,
    /// Address of the word that is not 0 while the module is armed, if there is one.
    armed: Option<u64>,
    /// The faults of the debug probe.
    detachments: Vec<ScheduledFault>,
    /// The faults of the core's own that are still to come.
    upsets: Vec<ScheduledFault>,
    is_attitude_masked: bool,
    /// Start of the NMI request after a failure of the clock.
    nmi_since_ns: Option<u64>,
    is_detached: bool,
    is_held: bool,
    stack: std::ops::Range<u64>,
    ram: Ram,
    probe: Option<Probe>,
    observer: Box<dyn Observer>,
    profile: Arc<Mutex<Profile>>,
    timer: Timer,
    next_service_ns: u64,
    /// End of the core's wait for the flash.
    stalled_until_ns: Option<u64>,
    reported_at: Instant,
    /// The account at the last edge, and the number of samples published before it.
    window: Option<(Box<Counts>, usize)>,
    /// The exception that publishes.
    attitude: Option<usize>,
    /// Exceptions entered for the samples before the first one was published.
    exceptions_before: u64,
    last_burst: Option<Burst>,
    /// The bursts without a published snapshot, in order.
    unpublished: Vec<Burst>,
    record: Record,
}

impl Recorder {
    /// A recorder of one run.
    #[must_use]
    pub fn new(
        firmware: &Firmware,
        end_ns: u64,
        probe: Option<Probe>,
        timer_starts_at: Option<u32>,
        faults: &[ScheduledFault],
        profile: Arc<Mutex<Profile>>,
        observer: Box<dyn Observer>,
    ) -> Self {
        let detaches = |fault: &&ScheduledFault| fault.kind == FaultKind::ProbeDetach;
        let upsets = |fault: &&ScheduledFault| {
            matches!(
                fault.kind,
                FaultKind::AttitudeLate
                    | FaultKind::Crash
                    | FaultKind::StackOverflow(_)
                    | FaultKind::DebuggerReset
            )
        };
        Self {
            end_ns,
            snapshot: firmware.snapshot,
            heading: firmware.heading,
            health: firmware.health,
            armed: firmware.armed,
            detachments: faults.iter().filter(detaches).copied().collect(),
            upsets: faults.iter().filter(upsets).copied().collect(),
            is_attitude_masked: false,
            nmi_since_ns: None,
            is_detached: false,
            is_held: false,
            stack: firmware.stack.clone(),
            ram: Ram::new(0),
            probe,
            observer,
            profile,
            timer: Timer {
                zero_ns: None,
                starts_at: timer_starts_at,
            },
            next_service_ns: 0,
            stalled_until_ns: None,
            reported_at: Instant::now(),
            window: None,
            attitude: None,
            exceptions_before: 0,
            last_burst: None,
            unpublished: Vec::new(),
            record: Record::default(),
        }
    }

    /// Seeds the content of the RAM at power-up.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.ram = Ram::new(seed);
        self
    }

    /// Returns the record, once the run is over.
    #[must_use]
    pub fn into_record(self) -> Record {
        self.record
    }

    fn counts(&self, retired: u64) -> Box<Counts> {
        let counts = self.profile.lock().map(|profile| profile.counts(retired));
        Box::new(counts.unwrap_or([0; EXCEPTIONS]))
    }

    /// Exceptions that were entered for the samples.
    fn sample_exceptions(&self) -> u64 {
        let own = INPUT_INTERRUPTS.into_iter().map(exception_of);
        let entered = |profile: std::sync::MutexGuard<'_, Profile>| {
            let exceptions = own.chain(self.attitude);
            exceptions.map(|number| profile.entries()[number]).sum()
        };
        self.profile.lock().map_or(0, entered)
    }

    /// Records the edges and bursts up to now.
    fn follow_sensor(&mut self, session: &mut Session<Board>, retired: u64) {
        let sensor = session.board_mut().controller.sensor();
        let bursts = sensor.take_bursts();
        self.last_burst = bursts.last().copied().or(self.last_burst);
        self.unpublished.extend(bursts);
        for edge in sensor.take_edges() {
            self.close_window(retired);
            self.window = Some((self.counts(retired), self.record.samples.len()));
            self.record.edges.push(edge);
        }
    }

    /// Credits the work since the last edge to the sample published in the meantime.
    fn close_window(&mut self, retired: u64) {
        let is_account = self
            .profile
            .lock()
            .is_ok_and(|profile| profile.is_account());
        let attitude = self.attitude.filter(|_| is_account);
        let (Some((before, published)), Some(attitude)) = (self.window.take(), attitude) else {
            return;
        };
        let now = self.counts(retired);
        let [sample] = &mut self.record.samples[published..] else {
            return;
        };
        let worked = |exception: usize| now[exception] - before[exception];
        let input: u64 = INPUT_INTERRUPTS
            .into_iter()
            .map(exception_of)
            .map(worked)
            .sum();
        sample.input_instructions = Some(input);
        sample.instructions = Some(input + worked(attitude));
    }

    /// Records a publication: the firmware has increased its sequence counter.
    fn published(&mut self, session: &mut Session<Board>, host: &mut dyn Host, hit: Hit) {
        self.follow_sensor(session, hit.instruction_count);
        self.read_heading(host);
        let Some(address) = self.snapshot else { return };
        // Start-up code clears the count.
        let is_published = Memory::read(host, address + SEQUENCE, Width::W32).unwrap_or(0) != 0;
        let (true, Some(snapshot)) = (is_published, read_snapshot(host, address)) else {
            return;
        };
        if snapshot.flags.contains(Flags::STALE) {
            self.record.stale.push(StaleSnapshot {
                snapshot,
                published_ns: hit.at.0,
            });
            return;
        }
        let taken = self.take_burst(&snapshot);
        let Some(burst) = taken.or(self.last_burst) else {
            return;
        };
        self.attitude = self.profile.lock().ok().map(|profile| profile.current());
        if self.record.first.is_none() {
            self.record.first = Some((hit.instruction_count, hit.at.0));
            self.exceptions_before = self.sample_exceptions();
        }
        let edge = burst.edge.and_then(|index| {
            let place = self
                .record
                .edges
                .binary_search_by_key(&index, |edge| edge.index)
                .ok()?;
            self.record.edges.get(place).copied()
        });
        self.record.samples.push(Sample {
            snapshot,
            heading: None,
            is_armed: self.armed.is_some_and(|address| is_armed(host, address)),
            published_ns: hit.at.0,
            burst,
            is_new: taken.is_some(),
            edge,
            true_t_us: edge.and_then(|edge| self.timer.microseconds(edge.time_ns)),
            instructions: None,
            input_instructions: None,
        });
    }

    /// Records the heading of the last sample, which follows its snapshot.
    fn read_heading(&mut self, host: &mut dyn Host) {
        if let (Some(address), Some(last)) = (self.heading, self.record.samples.last_mut()) {
            last.heading = read_heading(host, address);
        }
    }

    /// Returns the burst of a snapshot, usually the last one; `None` if none has come since the
    /// snapshot before. If the attitude task was late, several have. Then it is the burst whose
    /// edge fits the time step that the firmware reports.
    fn take_burst(&mut self, snapshot: &Snapshot) -> Option<Burst> {
        let edge_ns = |burst: &Burst| {
            let index = burst.edge?;
            let place = self
                .record
                .edges
                .binary_search_by_key(&index, |edge| edge.index);
            Some(self.record.edges.get(place.ok()?)?.time_ns)
        };
        let nearest = self.record.samples.last().and_then(|last| {
            let since_us = snapshot.t_us.checked_sub(last.snapshot.t_us)?;
            let expected_ns = last.edge?.time_ns + 1000 * since_us;
            let candidates = self.unpublished.iter().enumerate();
            candidates
                .filter_map(|(place, burst)| Some((place, edge_ns(burst)?)))
                .min_by_key(|&(_, at_ns)| at_ns.abs_diff(expected_ns))
        });
        match nearest {
            Some((place, _)) => self.unpublished.drain(..=place).next_back(),
            None => self.unpublished.drain(..).next_back(),
        }
    }

    /// Records the firmware's counters, if they have changed. Before the firmware's first start the
    /// report is random, its version too.
    fn read_health(&mut self, host: &mut dyn Host, now_ns: u64) -> Option<()> {
        let health = self.health?;
        let mut word = |offset: usize| {
            let value = Memory::read(host, health + offset as u64, Width::W32).ok()?;
            u32::try_from(value).ok()
        };
        if word(report::VERSION_OFFSET)? != report::VERSION {
            return None;
        }
        let mut reading = HealthReading {
            at_ns: now_ns,
            reset_cause: word(report::RESET_CAUSE)?,
            counters: [0; FaultClass::COUNT],
        };
        for (number, counter) in reading.counters.iter_mut().enumerate() {
            *counter = word(report::COUNTERS + 4 * number)?;
        }
        let is_new = |last: &HealthReading| {
            (last.reset_cause, last.counters) != (reading.reset_cause, reading.counters)
        };
        if self.record.health.last().is_none_or(is_new) {
            self.record.health.push(reading);
        }
        Some(())
    }

    /// Follows the faults of the debug probe and of the core, and the resets of the processor.
    fn follow_faults(&mut self, session: &mut Session<Board>, host: &mut dyn Host, now_ns: u64) {
        let resets = session.resets();
        if resets.len() > self.record.resets_ns.len() {
            self.record.resets_ns = resets.iter().map(|reset| reset.at.0).collect();
            self.timer.zero_ns = None;
            self.window = None;
        }
        self.upset_core(now_ns);
        let has_no_supply = session.unpowered();
        if has_no_supply {
            self.stalled_until_ns = None;
        }
        let controller = &mut session.board_mut().controller;
        self.ram.follow_supply(controller.supply_millivolts(), host);
        let is_held = has_no_supply
            || self.stalled_until_ns.is_some()
            || controller.is_core_held(now_ns)
            || self.hangs_in_nmi(controller.has_clock_failure(), now_ns);
        if is_held != self.is_held {
            self.is_held = is_held;
            host.hold(is_held);
        }
        let is_detached = self.detachments.iter().any(|fault| fault.lasts(now_ns));
        if is_detached != self.is_detached {
            self.is_detached = is_detached;
            if let Some(probe) = self.probe.as_ref().filter(|_| is_detached) {
                probe.make_log_wait(host);
            }
        }
        if let Some(ready_ns) = session.board_mut().controller.sensor().ready_at_ns()
            && self.record.sensor_ready_ns.last() != Some(&ready_ns)
        {
            self.record.sensor_ready_ns.push(ready_ns);
        }
    }

    /// Begins and ends the faults of the core itself.
    fn upset_core(&mut self, now_ns: u64) {
        let Ok(mut profile) = self.profile.lock() else {
            return;
        };
        let stack_end = u32::try_from(self.stack.start).unwrap_or(0);
        let mut is_masked = false;
        self.upsets.retain(|fault| {
            let begins = fault.start_ns <= now_ns;
            match fault.kind {
                FaultKind::AttitudeLate => {
                    is_masked |= fault.lasts(now_ns);
                    return now_ns < fault.end_ns();
                }
                FaultKind::Crash if begins => profile.upset(Upset::ThumbStateLost),
                FaultKind::DebuggerReset if begins => profile.upset(Upset::DebuggerReset),
                FaultKind::StackOverflow(room_bytes) if begins => {
                    profile.upset(Upset::StackPointer(stack_end + u32::from(room_bytes)));
                }
                _ => {}
            }
            !begins
        });
        if is_masked != self.is_attitude_masked {
            self.is_attitude_masked = is_masked;
            profile.upset(Upset::Masked(ATTITUDE_INTERRUPT, is_masked));
        }
    }

    /// Requests the NMI after a failure of the clock. Returns true if the handler does not clear
    /// the cause, so that the core executes nothing else.
    fn hangs_in_nmi(&mut self, has_failed: bool, now_ns: u64) -> bool {
        if !has_failed {
            self.nmi_since_ns = None;
            return false;
        }
        let since_ns = *self.nmi_since_ns.get_or_insert_with(|| {
            if let Ok(mut profile) = self.profile.lock() {
                profile.upset(Upset::NonMaskableInterrupt);
            }
            now_ns
        });
        now_ns >= since_ns + NMI_LIMIT_NS
    }

    /// Holds the core while the flash is busy, as its next fetch would.
    fn stall(&mut self, session: &mut Session<Board>, host: &mut dyn Host, now_ns: u64) {
        let end_ns = session.board_mut().controller.flash_busy_until_ns();
        if end_ns > now_ns && self.stalled_until_ns.is_none() {
            self.stalled_until_ns = Some(end_ns);
            self.is_held = true;
            host.hold(true);
            self.pause(session, now_ns);
        }
    }

    /// Pauses the run for the next event that is due.
    fn pause(&self, session: &mut Session<Board>, now_ns: u64) {
        let nmi_ns = self.nmi_since_ns.map(|since_ns| since_ns + NMI_LIMIT_NS);
        let nmi_ns = nmi_ns.filter(|&nmi_ns| nmi_ns > now_ns);
        let times_ns = [Some(self.next_service_ns), self.stalled_until_ns, nmi_ns];
        let next_ns = times_ns.into_iter().flatten().min();
        session.pause_at(next_ns.map(VirtualNanos));
    }

    /// Collects the firmware's outputs and informs the observer.
    fn serve(&mut self, session: &mut Session<Board>, host: &mut dyn Host, now_ns: u64) {
        self.read_health(host, now_ns);
        let terminal = session.board_mut().controller.terminal();
        let mut received = terminal.take();
        let answer = self.observer.uart(now_ns, &received);
        terminal.send(now_ns, &answer);
        self.record.received.append(&mut received);
        if let Some(probe) = self.probe.as_mut().filter(|_| !self.is_detached) {
            for line in probe.drain(host, now_ns) {
                self.observer.log(&line);
                self.record.log.push(line);
            }
        }
        if !self.observer.keeps_record() {
            self.record.forget();
        }
        if self.reported_at.elapsed().as_millis() >= 100 {
            self.reported_at = Instant::now();
            self.observer.progress(Progress {
                now_ns,
                end_ns: self.end_ns,
            });
        }
    }

    fn end(&mut self, session: &mut Session<Board>, host: &mut dyn Host, stop: Stop) {
        self.follow_sensor(session, stop.instruction_count);
        self.close_window(stop.instruction_count);
        self.read_heading(host);
        self.serve(session, host, stop.at.0);
        let steps = session.board_mut().controller.steps_at_faults();
        self.record.steps_at_faults = steps.to_vec();
        let wires = session.board_mut().controller.sensor().wires();
        self.record.falls_by_hand = wires.lock().falls_made();
        self.record.writes_left = wires.lock().writes_left();
        self.record.bytes_by_hand = wires.lock().bytes_made();
        self.record.prefetches = session.board().controller.prefetches();
        self.record.ram_power_ups = self.ram.power_ups();
        self.record.last = (stop.instruction_count, stop.at.0);
        self.record.sample_exceptions = self.sample_exceptions() - self.exceptions_before;
        self.record.instructions = self.counts(stop.instruction_count).to_vec();
        let lowest_used = self.stack.clone().step_by(4).find(|&address| {
            let unused = [Some(STACK_PATTERN), self.ram.word_at_power_up(address)];
            host.read(address, Width::W32)
                .is_ok_and(|word| !unused.contains(&u32::try_from(word).ok()))
        });
        self.record.stack_bytes_used = self.stack.end - lowest_used.unwrap_or(self.stack.end);
    }
}

impl Driver<Board> for Recorder {
    fn on_settled(&mut self, session: &mut Session<Board>, host: &mut dyn Host, settled: Settled) {
        match settled {
            Settled::Access { access, .. } => {
                self.record.accesses += u64::from(self.record.first.is_some());
                let is_timer = (TIM5.base..TIM5.base + TIM5.size).contains(&access.address);
                if is_timer && access.kind == AccessKind::Write {
                    self.timer.written(
                        session,
                        access.address - TIM5.base,
                        access.value,
                        access.virtual_time,
                    );
                }
                if (FLASH.base..FLASH.base + FLASH.size).contains(&access.address) {
                    self.stall(session, host, access.virtual_time.0);
                }
            }
            Settled::Hit(hit) => {
                if self.snapshot.map(|address| address + SEQUENCE) == Some(hit.address) {
                    self.published(session, host, hit);
                } else {
                    self.read_health(host, hit.at.0);
                }
            }
            Settled::Stop(stop) => {
                if self
                    .stalled_until_ns
                    .is_some_and(|end_ns| stop.at.0 >= end_ns)
                {
                    self.stalled_until_ns = None;
                }
                self.follow_faults(session, host, stop.at.0);
                self.follow_sensor(session, stop.instruction_count);
                if stop.at.0 >= self.next_service_ns {
                    self.serve(session, host, stop.at.0);
                    self.next_service_ns = stop.at.0 + SERVICE_PERIOD_NS;
                }
                self.pause(session, stop.at.0);
            }
            _ => {}
        }
    }

    fn on_stop(
        &mut self,
        session: &mut Session<Board>,
        stop: Stop,
        host: &mut dyn Host,
    ) -> Option<VirtualNanos> {
        if stop.instruction_count == 0 {
            // Before the first instruction.
            self.ram.power_up(host);
            let counters = self.health.map(|health| Watch::Writes {
                address: health + report::COUNTERS as u64,
                length: 4 * FaultClass::COUNT as u64,
            });
            let sequence = self.snapshot.map(|address| Watch::Writes {
                address: address + SEQUENCE,
                length: 4,
            });
            for watch in sequence.into_iter().chain(counters) {
                session.watch(watch);
            }
            return Some(VirtualNanos(self.end_ns));
        }
        self.end(session, host, stop);
        None
    }
}
