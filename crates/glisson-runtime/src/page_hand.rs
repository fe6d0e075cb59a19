//! An instrument in the hand of the viewer's page: what the page says of it, and what a hand would feel.

use crate::exchange::{Latest, Publisher, exchange};
use glisson::math::DVec3;
use glisson::tool::ToolInput;

/// The largest force that is told [N], as of a large desktop device: a choice.
pub const GREATEST_FORCE_N: f64 = 10.0;

/// What the page says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Aim {
    pub(crate) pose: ToolInput,
    /// The instrument is put there, whatever is between.
    pub(crate) is_at_once: bool,
    /// Whether a page has control.
    pub(crate) is_controlled: bool,
}

/// What the device tells the page.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Felt {
    /// Force that a hand would feel, in the world [N].
    pub force_n: DVec3,
    /// Whether a page holds the instrument; otherwise it stays where it was.
    pub is_held: bool,
}

/// The server's end of the device.
pub struct PageHand {
    aims: Publisher<Aim>,
    aim: Aim,
    home: ToolInput,
    felt: Latest<Felt>,
}

/// The device's end.
pub(crate) struct PageDeviceEnd {
    pub(crate) aims: Latest<Aim>,
    pub(crate) felt: Publisher<Felt>,
}

impl PageHand {
    /// Both ends, for an instrument whose home is `home`.
    pub(crate) fn joined(home: &ToolInput) -> (PageDeviceEnd, Self) {
        let aim = Aim { pose: *home, is_at_once: false, is_controlled: false };
        let (aims, aims_out) = exchange(aim);
        let (felt_in, felt) = exchange(Felt::default());
        (PageDeviceEnd { aims: aims_out, felt: felt_in }, Self { aims, aim, home: *home, felt })
    }

    /// The page has the instrument here.
    pub fn aim(&mut self, pose: ToolInput) {
        self.say(Aim { pose, is_at_once: false, ..self.aim });
    }

    /// The instrument is back at its home at once.
    pub fn go_home(&mut self) {
        self.say(Aim { pose: self.home, is_at_once: true, ..self.aim });
    }

    /// Whether a page has control.
    pub fn set_controlled(&mut self, is_controlled: bool) {
        self.say(Aim { is_controlled, ..self.aim });
    }

    fn say(&mut self, aim: Aim) {
        self.aim = aim;
        self.aims.publish(aim);
    }

    /// What the device told last.
    pub fn felt(&mut self) -> Felt {
        self.felt.get()
    }
}
