"""What is done about the faults of a dataset."""

from pipeline.dataset.format.layout import OWNED
from pipeline.dataset.format.manifest import Manifest, manifest_or_copy
from pipeline.dataset.stages.begun import refuse_versions
from pipeline.dataset.stages.solve import complete
from pipeline.dataset.stages.verify import CUT_SHORT, UNTIMED, Fault, verify
from pipeline.jobs.workers import Workers
from pipeline.progress import SILENT, Progress
from pipeline.storage.folder import Folder, Where, open_folder
from pipeline.storage.layout import COPY, FOREIGN, TIMED, TIMINGS
from pipeline.storage.ledger import Ledger, committed, set_aside
from pipeline.storage.lock import sole_writer


def repair(
    where: Where | Folder,
    *,
    yes: bool = False,
    workers: Workers | None = None,
    progress: Progress = SILENT,
) -> list[Fault]:
    """Do again exactly the shards that have faults, and set foreign files aside.

    What was in a damaged file's place is kept in ``_damaged/``, foreign files in ``_foreign/``.

    Args:
        where: a dataset.
        yes: also set files aside that hold sound rows, which are not what the manifest says.
        workers: what to work with; all cores of this machine by default.
        progress: told how far it is, and of each file that is set aside.

    Returns:
        The faults that were found; without ``yes`` those of files with sound rows are still there.

    Raises:
        InputError: where the folder holds no dataset, another process writes to it, or it was
            made with other versions.
        ProlearnError: where the folder cannot be written to or workers are killed again and again.
    """
    folder, workers = open_folder(where), workers or Workers()
    manifest_or_copy(folder)  # before the lock, which would make a folder
    with sole_writer(folder, OWNED):
        manifest, _ = manifest_or_copy(folder)
        refuse_versions(folder, manifest)
        faults = list(verify(folder, workers=workers, progress=progress))
        left = {fault.path for fault in faults if fault.sound and not yes}
        for fault in faults:
            if fault.path not in left and _is_in_the_way(fault, folder):
                set_aside(folder, fault.path, progress, *[FOREIGN] * fault.foreign)
        with committed(Ledger(folder, manifest, progress)) as ledger:
            _disown(ledger, {fault.path for fault in faults} - left)
            complete(ledger, workers, progress, leave=left)
    return faults


def _is_in_the_way(fault: Fault, folder: Folder) -> bool:
    """Whether a file has to go; one of a run that was cut short may be sound."""
    replaced = fault.path in (COPY, TIMED) or fault.what in (CUT_SHORT, UNTIMED)
    return not replaced and folder.exists(fault.path)


def _disown(ledger: Ledger[Manifest], names: set[str]) -> None:
    """Count damaged shards no longer; timings come from solving, so with them goes the plan."""
    ledger.disown({name.removeprefix(TIMINGS) for name in names})
