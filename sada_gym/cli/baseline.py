"""The fooling rate of uniform worlds, without which an attack fooling rate says little."""

from __future__ import annotations

from sada_gym import adversaries
from sada_gym.measures.reference import FOLDER, Reference, load_reference, read_index
from sada_gym.runs.record import RunReport, RunSettings


def uniform_baseline(report: RunReport) -> str:
    """Say how often uniform worlds fool the agent, and where the figure is from."""
    settings = report.settings
    reference = find_reference(settings)
    if reference is not None:
        entry = reference.entry
        source = f"{entry.points * entry.seeds:,} evaluations, shipped reference set"
        return f"{100 * reference.uniform_rate:.1f} % ({source})"
    if settings.adversary == "random":
        return f"{100 * report.afr:.1f} % (these samples are uniform)"
    rate = report.search.fooling_rate
    if rate is not None and adversaries.find(settings.adversary).uniform_queries:
        return f"{100 * rate:.1f} % (its {report.search.queries:,} training queries are uniform)"
    return "not known: run --adversary random"


def find_reference(settings: RunSettings) -> Reference | None:
    """Find the shipped reference set of exactly what was attacked; None where there is none."""
    from sada_gym.registration import ids_of, make_application

    fixed = ids_of()
    for entry in read_index(FOLDER).references:
        if (entry.agent, entry.fingerprint) != (settings.agent, settings.fingerprint):
            continue
        keywords = fixed.get(entry.track, {})
        if any(settings.application_settings.get(k) != v for k, v in keywords.items()):
            continue
        application = make_application(entry.track, agent=entry.agent)
        try:
            same = (application.version, application.settings)
            if same == (settings.version, settings.application_settings):
                return load_reference(entry.track, application)
        finally:
            application.close()
    return None
