//! Who watches, what is drawn on the tissue, and where somebody points: of all pages, and none of it changes the simulation.
//!
//! Places are those of the tissue at rest, so that what is drawn goes with it.

use glisson::math::DVec3;
use glisson::record::note::Note;
use glisson_runtime::control::{Control, Viewer};
use serde::Serialize;
use std::sync::{Mutex, PoisonError};
use std::time::Instant;
use tokio::sync::watch;

/// Signs of a name at most: a choice.
pub(crate) const LONGEST_NAME: usize = 40;
/// Strokes and marks at most; the oldest goes. A choice.
const MOST_MARKS: usize = 100;

/// Somebody who watches.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Person {
    pub(crate) number: u64,
    /// Empty where nobody gave one.
    name: String,
    is_teacher: bool,
    /// Where this one points, on the tissue at rest [m].
    points_at_m: Option<[f64; 3]>,
}

/// What is drawn on the tissue.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Mark {
    /// Number of who drew it.
    by: u64,
    /// A place, or the points of a stroke, on the tissue at rest [m].
    points_m: Vec<[f64; 3]>,
}

/// All of it, as it is now.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Present {
    /// In the order in which they came.
    pub people: Vec<Person>,
    /// The oldest first.
    pub marks: Vec<Mark>,
}

/// What somebody wants of the class.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum ClassWish {
    /// This is my name.
    Introduce(String),
    /// I point there, or no longer.
    Point(Option<[f64; 3]>),
    /// A place or a stroke: of who teaches.
    Draw(Vec<[f64; 3]>),
    /// All of it goes: of who teaches.
    Erase,
    /// Control comes here: of who teaches.
    TakeOver,
    /// It goes back to who had it.
    GiveBack,
}

impl ClassWish {
    /// What of it a session keeps.
    pub(crate) fn note(&self) -> Option<Note> {
        match self {
            Self::Draw(points_m) => {
                Some(Note::Drawing { points_m: points_m.iter().copied().map(DVec3::from_array).collect() })
            }
            Self::Erase => Some(Note::Erased {}),
            _ => None,
        }
    }
}

/// The class of one simulation.
pub struct Class {
    present: watch::Sender<Present>,
    /// When the last one left, while nobody is there.
    empty_since: Mutex<Option<Instant>>,
}

impl Default for Class {
    fn default() -> Self {
        Self { present: watch::Sender::new(Present::default()), empty_since: Mutex::default() }
    }
}

impl Class {
    /// Tells all that changes.
    pub fn watch(&self) -> watch::Receiver<Present> {
        self.present.subscribe()
    }

    pub(crate) fn enter(&self, viewer: Viewer, is_teacher: bool) {
        let person = Person { number: viewer.number, name: String::new(), is_teacher, points_at_m: None };
        self.present.send_modify(|present| {
            present.people.push(person);
            self.note_end(None);
        });
    }

    pub(crate) fn leave(&self, viewer: Viewer) {
        self.present.send_modify(|present| {
            present.people.retain(|person| person.number != viewer.number);
            self.note_end(present.people.is_empty().then(Instant::now));
        });
    }

    fn note_end(&self, end: Option<Instant>) {
        *self.empty_since.lock().unwrap_or_else(PoisonError::into_inner) = end;
    }

    /// Since when nobody is there any more; none where somebody is, and before the first one.
    pub fn empty_since(&self) -> Option<Instant> {
        *self.empty_since.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Does what is wanted, or says why not.
    pub(crate) fn obey(
        &self,
        wish: ClassWish,
        viewer: Viewer,
        control: &Control,
    ) -> Result<(), &'static str> {
        let is_own = |person: &&mut Person| person.number == viewer.number;
        let mut change = Ok(());
        self.present.send_if_modified(|present| {
            let Present { people, marks } = present;
            let Some(person) = people.iter_mut().find(is_own) else { return false };
            match wish {
                ClassWish::Introduce(name) => person.name = name,
                ClassWish::Point(place) => person.points_at_m = place,
                ClassWish::GiveBack => control.give_back(viewer),
                _ if !person.is_teacher => {
                    change = Err("only who teaches may do that: the program prints the address for it");
                    return false;
                }
                ClassWish::Draw(points_m) => {
                    if marks.len() == MOST_MARKS {
                        marks.remove(0);
                    }
                    marks.push(Mark { by: viewer.number, points_m });
                }
                ClassWish::Erase => marks.clear(),
                ClassWish::TakeOver => control.take_over(viewer),
            }
            true
        });
        change
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_empty_from_when_the_last_one_left() {
        let (class, control) = (Class::default(), Control::default());
        assert!(class.empty_since().is_none(), "nobody has come yet");
        let [one, other] = [(); 2].map(|()| control.enter().unwrap());
        class.enter(one, false);
        class.enter(other, false);
        class.leave(one);
        assert!(class.empty_since().is_none());
        class.leave(other);
        assert!(class.empty_since().is_some());
        class.enter(one, false);
        assert!(class.empty_since().is_none());
    }

    #[test]
    fn who_teaches_draws_and_takes_over_and_the_others_are_told_why_not() {
        let (class, control) = (Class::default(), Control::default());
        let [learner, teacher] = [(); 2].map(|()| control.enter().unwrap());
        class.enter(learner, false);
        class.enter(teacher, true);
        let present = || class.watch().borrow().clone();
        let stroke = vec![[0.0, 0.0, 0.1], [0.0, 0.01, 0.1]];
        class.obey(ClassWish::Draw(stroke.clone()), teacher, &control).unwrap();
        assert_eq!(present().marks, [Mark { by: teacher.number, points_m: stroke.clone() }]);
        for wish in [ClassWish::Draw(stroke.clone()), ClassWish::Erase, ClassWish::TakeOver] {
            assert!(class.obey(wish, learner, &control).unwrap_err().contains("only who teaches"));
        }
        assert_eq!(present().marks.len(), 1);
        class.obey(ClassWish::Introduce("Ada".into()), learner, &control).unwrap();
        class.obey(ClassWish::Point(Some([0.1; 3])), learner, &control).unwrap();
        assert_eq!(
            (present().people[0].name.as_str(), present().people[0].points_at_m),
            ("Ada", Some([0.1; 3]))
        );
        assert!(control.may_control(learner));
        class.obey(ClassWish::TakeOver, teacher, &control).unwrap();
        assert!(control.may_control(teacher) && !control.may_control(learner));
        class.obey(ClassWish::GiveBack, teacher, &control).unwrap();
        assert!(control.may_control(learner));
        for _ in 0..2 * MOST_MARKS {
            class.obey(ClassWish::Draw(stroke.clone()), teacher, &control).unwrap();
        }
        assert_eq!(present().marks.len(), MOST_MARKS);
        class.obey(ClassWish::Erase, teacher, &control).unwrap();
        class.leave(learner);
        assert_eq!((present().marks.len(), present().people.len()), (0, 1));
    }
}
