//! Commands that set the format, the rate and the baud rate of the UART.

use super::super::answer::{Kind, Reply};
use super::super::baud::BaudChange;
use super::super::command::BAUD_RATES;
use super::Console;
use crate::settings::Preferences;
use crate::telemetry;

impl Console {
    /// Sets format and rate, if the UART can carry them.
    pub(super) fn set_preferences(
        &mut self,
        preferences: Preferences,
        reply: &mut Reply<'_>,
    ) -> Kind {
        let Preferences {
            format,
            rate_hz,
            baud,
        } = preferences;
        let max_hz = telemetry::largest_rate_hz(format, baud);
        if max_hz == 0 {
            return reply.error(format_args!(
                "{} takes more than {baud} baud: a higher baud rate first",
                format.name()
            ));
        }
        if u32::from(rate_hz) > max_hz {
            let or_baud = match BAUD_RATES {
                [.., highest] if baud >= highest => "",
                _ => ", or a higher baud rate",
            };
            return reply.error(format_args!(
                "{rate_hz} lines of {} a second are too many for {baud} baud: \
                 \"rate {max_hz}\" fits{or_baud}",
                format.name()
            ));
        }
        self.working.preferences = preferences;
        reply.ok(format_args!(
            "{}, {rate_hz} a second; \"save\" keeps it",
            format.name()
        ))
    }

    /// Requests a change of the baud rate, if the new rate carries the format in use.
    pub(super) fn request_baud(&mut self, baud: u32, reply: &mut Reply<'_>) -> Kind {
        let Preferences {
            format,
            rate_hz,
            baud: before,
        } = self.working.preferences;
        let max_hz = telemetry::largest_rate_hz(format, baud);
        if max_hz == 0 {
            return reply.error(format_args!(
                "{baud} baud are too few for {}: another format first",
                format.name()
            ));
        }
        if u32::from(rate_hz) > max_hz {
            return reply.error(format_args!(
                "{baud} baud are too few for {rate_hz} lines of {} a second: \"rate {max_hz}\" \
                 first",
                format.name()
            ));
        }
        if baud == before {
            return reply.ok(format_args!("baud {baud}: as before"));
        }
        self.baud = BaudChange::Requested(baud);
        reply.ok(format_args!(
            "baud {baud} from now on; say something at {baud} within 10 s, or it is {before} again"
        ))
    }
}
