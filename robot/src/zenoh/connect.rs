//! The scheduler's side of a connection, which connects to a robot.

use std::any::Any;
use std::io;
use std::sync::Arc;
use std::time::Duration;

use ::zenoh::query::{QueryTarget, Reply};
use ::zenoh::sample::Sample;
use ::zenoh::{Session, Wait};
use tokio::sync::{mpsc, oneshot};

use super::keys::{Key, LinkId, STOPS, asks_to_hear, hears};
use super::network::{Network, Urgency};
use super::offers::Offers;
use super::stream::{Shared, Stream, Target, link_of};

/// Time limit for the robot's answer to the request that opens a connection.
const ANSWERS_WITHIN: Duration = Duration::from_secs(2);

/// Connects to the robot at a key.
///
/// # Errors
/// There is no robot at the key, there are several, or the network does not carry messages.
pub async fn connect(network: &Network, key: &Key, haste: Urgency) -> io::Result<Stream> {
    open(network, key, haste, &[]).await
}

/// Like [`connect`], for a connection that may refer to texts which are published once for several robots ([`Stream::offer`]). It may do
/// so only if the robot at the key receives such texts. `audiences` are the groups to which the robot belongs, as numbers in this
/// session; at most [`AUDIENCES_MAX`](super::AUDIENCES_MAX).
///
/// # Errors
/// Those of [`connect`].
pub async fn connect_sharing(network: &Network, key: &Key, audiences: &[u32]) -> io::Result<Stream> {
    open(network, key, Urgency::None, audiences).await
}

async fn open(network: &Network, key: &Key, haste: Urgency, audiences: &[u32]) -> io::Result<Stream> {
    let nobody = || {
        let why = "no robot answers at this key: the robot, or a router on the path to it, is not running";
        io::Error::new(io::ErrorKind::NotFound, why)
    };
    if network.tokens().have_left(key) {
        return Err(nobody());
    }
    let being_opened = network.may_open(haste).await?;
    let (link, pipe) = (network.connection()?, Shared::default());
    let (answer, mut answers) = mpsc::unbounded_channel();
    let (told, opened) = oneshot::channel();
    let stream = Stream::new(network.clone(), pipe.clone(), link, Target::new(key.to())?, haste);
    let opening = Opening {
        key: key.clone(),
        network: network.clone(),
        link,
        pipe: pipe.clone(),
        haste,
        audiences: audiences.to_owned(),
    };
    network.declare(haste, move |session| {
        let _waits = told.send(opening.open(session, answer).map_err(|error| error.to_string()));
    });
    let kept = opened.await.map_err(|_| io::Error::other("the Zenoh session has ended"))?;
    let Opened { kept, offers } = kept.map_err(io::Error::other)?;
    let mut robots = Vec::new();
    while let Some(answer) = answers.recv().await {
        robots.push(answer.map_err(|why| io::Error::new(io::ErrorKind::TimedOut, why))?);
    }
    drop(being_opened);
    let (robot, hears) = match robots.as_slice() {
        [(robot, hears)] => (robot, *hears),
        [] => return Err(nobody()),
        _ => return Err(io::Error::other("several robots answer at this key; each robot needs its own key")),
    };
    let following = network.tokens().follow_seen(&key.robot(robot), &pipe).await?;
    let stream = stream.keeping(Box::new((kept, following)));
    Ok(match offers.filter(|_| hears) {
        Some(offers) => stream.heard_by(key.clone(), offers),
        None => stream,
    })
}

/// A connection that is being opened.
struct Opening {
    key: Key,
    network: Network,
    link: LinkId,
    pipe: Shared,
    haste: Urgency,
    audiences: Vec<u32>,
}

/// The resources of a connection that has been opened.
struct Opened {
    /// Zenoh declarations, which must exist as long as the connection.
    kept: Box<dyn Any + Send>,
    offers: Option<Arc<Offers>>,
}

/// Id of a robot's session, and whether the robot receives texts that are published for several robots.
type Robot = (String, bool);

impl Opening {
    /// Declares the Zenoh resources of the connection, and then asks the robot to open it.
    fn open(
        self,
        session: &Session,
        answer: mpsc::UnboundedSender<Result<Robot, String>>,
    ) -> ::zenoh::Result<Opened> {
        let Self { key, network, link, pipe, haste, audiences } = self;
        network.watch(session, key.robots_beside())?;
        network.show(session, key.scheduler(network.id()))?;
        let asks = asks_to_hear(&audiences);
        let offers = asks.as_ref().map(|_| network.offers(session, &key)).transpose()?;
        let offers = offers.filter(|offers| offers.reach(&key));
        // Declared separately, so that Zenoh delivers frames to the connections of this robot without comparing them with other keys.
        let from = session.declare_keyexpr(key.from(network.id())).wait()?;
        let frames = session.declare_subscriber(from.clone());
        let own = move |sample: Sample| {
            if link_of(&sample) == Some(link) && pipe.receive(&sample).is_some() {
                pipe.lock()
                    .break_off("the robot referred to a published script, but only schedulers may do that");
            }
        };
        let frames = frames.callback(own).wait()?;
        let reply = move |reply: Reply| {
            let said = reply.result().map_err(|error| read(error.payload()));
            let robot = |sample: &Sample| (read(sample.payload()), hears(sample.attachment()));
            let _gave_up = answer.send(said.map(robot));
        };
        let asked = match haste {
            Urgency::None => link.to_string(),
            Urgency::Stop => format!("{link} {STOPS}"),
        };
        let asking = session.get(key.open()).payload(asked).target(QueryTarget::All);
        let asking = asking.attachment(offers.as_ref().and(asks));
        asking.timeout(ANSWERS_WITHIN).priority(haste.priority()).callback(reply).wait()?;
        Ok(Opened { kept: Box::new((frames, from)), offers })
    }
}

fn read(payload: &::zenoh::bytes::ZBytes) -> String {
    String::from_utf8_lossy(&payload.to_bytes()).into_owned()
}
