//! The metrics page, in the text format of Prometheus.

use downbeat_robot::figures::{BOUNDS_US, Distribution};
use prometheus::TextEncoder;
use prometheus::proto::{
    Bucket, Counter, Gauge, Histogram, LabelPair, Metric as Value, MetricFamily, MetricType,
};

use super::names::{Metric, MetricKind};

/// The HTTP content type of the page that [`Page::text`] returns.
pub(super) const CONTENT_TYPE: &str = prometheus::TEXT_FORMAT;

/// A source of metrics, such as a mission or a host.
pub(crate) trait Source: Send + Sync {
    /// Writes the current values of all metrics of this source to the page.
    fn write(&self, page: &mut Page);
}

/// A metrics page: text to which metrics are appended one after the other. The values of all robots are therefore in memory only as text.
#[derive(Debug, Default)]
pub(crate) struct Page(String);

impl Page {
    pub(super) fn one(&mut self, metric: &Metric, value: f64) {
        self.family(metric, vec![number(metric, Vec::new(), value)]);
    }

    /// Writes a metric with a single value, unless the value is unknown (NaN).
    pub(super) fn known(&mut self, metric: &Metric, value: f64) {
        if !value.is_nan() {
            self.one(metric, value);
        }
    }

    /// Writes a metric with a value for each label, except for unknown values (NaN).
    pub(super) fn each<'a>(&mut self, metric: &Metric, values: impl Iterator<Item = (&'a str, f64)>) {
        let known = values.filter(|(_, value)| !value.is_nan());
        let values = known.map(|(label, value)| number(metric, labelled(metric.label, label), value));
        self.family(metric, values.collect());
    }

    /// Writes a metric that shows a state: the value 1 for the current label `now`, and 0 for the other labels.
    pub(super) fn state(&mut self, metric: &Metric, labels: &[&str], now: &str) {
        self.each(metric, labels.iter().map(|label| (*label, f64::from(u8::from(*label == now)))));
    }

    #[expect(clippy::cast_precision_loss, reason = "bounds are small")]
    pub(super) fn distribution(&mut self, metric: &Metric, values: &Distribution) {
        let cumulated = values.cumulated();
        let buckets = BOUNDS_US.iter().zip(cumulated).map(|(bound, count)| {
            let mut bucket = Bucket::default();
            bucket.set_upper_bound(*bound as f64 / 1e6);
            bucket.set_cumulative_count(count);
            bucket
        });
        let mut histogram = Histogram::default();
        histogram.set_bucket(buckets.collect());
        histogram.set_sample_sum(values.sum_seconds());
        histogram.set_sample_count(cumulated[BOUNDS_US.len()]);
        let mut value = Value::default();
        value.set_histogram(histogram);
        self.family(metric, vec![value]);
    }

    fn family(&mut self, metric: &Metric, values: Vec<Value>) {
        if values.is_empty() {
            return;
        }
        let mut family = MetricFamily::default();
        family.set_name(metric.name.to_owned());
        family.set_help(metric.help.to_owned());
        family.set_field_type(match metric.kind {
            MetricKind::Gauge => MetricType::GAUGE,
            MetricKind::Counter => MetricType::COUNTER,
            MetricKind::Histogram => MetricType::HISTOGRAM,
        });
        family.set_metric(values);
        if let Err(error) = TextEncoder::new().encode_utf8(&[family], &mut self.0) {
            tracing::warn!("the metric {} is left out: {error}", metric.name);
        }
    }

    /// Returns the text of a page with the metrics of all sources.
    pub(super) fn text<'a>(sources: impl Iterator<Item = &'a dyn Source>) -> String {
        let mut page = Self::default();
        page.each(&super::names::BUILD_INFO, std::iter::once((env!("CARGO_PKG_VERSION"), 1.0)));
        sources.for_each(|source| source.write(&mut page));
        page.0
    }
}

fn number(metric: &Metric, labels: Vec<LabelPair>, number: f64) -> Value {
    let mut value = Value::from_label(labels);
    if metric.kind == MetricKind::Counter {
        let mut counter = Counter::default();
        counter.set_value(number);
        value.set_counter(counter);
    } else {
        let mut gauge = Gauge::default();
        gauge.set_value(number);
        value.set_gauge(gauge);
    }
    value
}

fn labelled(name: &str, value: &str) -> Vec<LabelPair> {
    let mut label = LabelPair::default();
    label.set_name(name.to_owned());
    label.set_value(value.to_owned());
    vec![label]
}
