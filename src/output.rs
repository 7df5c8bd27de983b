//! [`Output`]: the folder that a run leaves, whole or not at all.
//!
//! Files are written to `DIR.partial` beside the folder asked for, which gets its name only when
//! everything is on disk. So `DIR`, where it exists, is a complete run: neither a full disk nor
//! an interrupt nor a power cut leaves a folder that looks finished and is not.

use std::ffi::OsString;
use std::fs::{self, File, TryLockError};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

/// The file by which a folder is known to be a run's; every run writes it.
pub const RUN_FILE: &str = "run.json";

/// Locked while a run writes, so that the leftovers of a killed run can be told from a live one.
const LOCK_FILE: &str = ".lock";

/// A run's folder while it is written.
///
/// Dropped without [`Output::commit`], it removes what it wrote, and the parent folders that it
/// made.
#[derive(Debug)]
pub struct Output {
    dir: PathBuf,
    partial: PathBuf,
    /// Where the run that is replaced stands while the new one takes its place.
    replaced: PathBuf,
    replace: bool,
    /// Parent folders that were made for this run, innermost first.
    made: Vec<PathBuf>,
    lock: Option<File>,
    /// Whether the partial folder is this run's, so that dropping removes it.
    owned: bool,
}

/// Why a run's folder cannot be made or filled.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    /// The folder exists.
    #[error(
        "the output folder {dir} exists: choose another with --out DIR, or replace it with --force",
        dir = dir.display()
    )]
    Exists {
        /// The folder.
        dir: PathBuf,
    },
    /// Something that is not a folder has the folder's name.
    #[error("the output folder {dir} is a file: choose another with --out DIR", dir = dir.display())]
    IsFile {
        /// The path.
        dir: PathBuf,
    },
    /// The folder to be replaced holds something else than a run.
    #[error(
        "the output folder {dir} holds no {RUN_FILE}, so it is not a run's, and --force does not \
         replace it: choose another with --out DIR",
        dir = dir.display()
    )]
    NotARun {
        /// The folder.
        dir: PathBuf,
    },
    /// The path does not end in a name.
    #[error(
        "the output folder \"{dir}\" has no name of its own: give one, such as --out results",
        dir = dir.display()
    )]
    NoName {
        /// The path.
        dir: PathBuf,
    },
    /// Another run writes to the same folder.
    #[error(
        "another run is writing {partial}: wait for it, or choose another folder with --out DIR",
        partial = partial.display()
    )]
    Busy {
        /// The folder of the other run.
        partial: PathBuf,
    },
    /// A replacement was cut short and the earlier run was left aside.
    #[error(
        "{replaced} is an earlier run, set aside by a --force that was cut short: move it back or \
         remove it",
        replaced = replaced.display()
    )]
    SetAside {
        /// The earlier run's folder.
        replaced: PathBuf,
    },
    /// The folder cannot be made or named.
    #[error("cannot make the output folder {dir}", dir = dir.display())]
    Folder {
        /// The folder.
        dir: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// The run is in place, but the earlier one that it replaces cannot be removed.
    #[error(
        "the run is complete in {dir}, but the earlier one cannot be removed from {replaced}",
        dir = dir.display(),
        replaced = replaced.display()
    )]
    NotRemoved {
        /// The run's folder.
        dir: PathBuf,
        /// The earlier run's folder.
        replaced: PathBuf,
        /// Why.
        source: io::Error,
    },
    /// A file cannot be written.
    #[error("cannot write {path}, so this run left no results", path = path.display())]
    Write {
        /// The file, by the name that it was to have.
        path: PathBuf,
        /// Why.
        source: io::Error,
    },
}

impl Output {
    /// Checks that a run may be written to `dir` and makes its partial folder; `replace` allows an
    /// earlier run there, which stays until [`Output::commit`]. Missing parents are made.
    ///
    /// # Errors
    /// `dir` exists (and is not an earlier run that may be replaced), another run writes to it, or
    /// its folder cannot be made.
    pub fn create(dir: &Path, replace: bool) -> Result<Self, OutputError> {
        // A link to a folder is replaced where it points to, not the link itself.
        let dir =
            if dir.is_symlink() { dir.canonicalize().unwrap_or(dir.into()) } else { dir.into() };
        if dir.file_name().is_none() {
            return Err(OutputError::NoName { dir });
        }
        check_target(&dir, replace)?;
        let (partial, replaced) = (beside(&dir, ".partial"), beside(&dir, ".replaced"));
        if replaced.exists() {
            return Err(OutputError::SetAside { replaced });
        }
        let mut output =
            Self { dir, partial, replaced, replace, made: Vec::new(), lock: None, owned: false };
        output.make_parents()?;
        output.make_partial()?;
        Ok(output)
    }

    /// The folder that the run will have.
    pub fn dir(&self) -> &Path {
        &self.dir
    }

    /// The folder in which the run stands until it is committed.
    pub fn partial(&self) -> &Path {
        &self.partial
    }

    /// Opens the file `name` for writing, buffered; close it with [`OutputFile::finish`].
    ///
    /// # Errors
    /// The file cannot be made.
    pub fn file(&self, name: &str) -> Result<OutputFile, OutputError> {
        let path = self.dir.join(name);
        match File::create(self.partial.join(name)) {
            Ok(file) => Ok(OutputFile { writer: BufWriter::new(file), path }),
            Err(source) => Err(OutputError::Write { path, source }),
        }
    }

    /// Writes the file `name` with `write` and closes it.
    ///
    /// # Errors
    /// Whatever `write` returns, or the file cannot be made or closed.
    pub fn write(
        &self,
        name: &str,
        write: impl FnOnce(&mut OutputFile) -> io::Result<()>,
    ) -> Result<(), OutputError> {
        let mut file = self.file(name)?;
        match write(&mut file) {
            Ok(()) => file.finish(),
            Err(source) => Err(OutputError::Write { path: file.path.clone(), source }),
        }
    }

    /// Gives the folder its name. Without an earlier run to replace this is one rename, seen by
    /// others entirely or not at all; with one, that is set aside first and removed afterwards.
    ///
    /// # Errors
    /// The name was taken since, or the folder cannot be renamed; then the earlier run stands
    /// again and nothing of this one is left.
    pub fn commit(mut self) -> Result<PathBuf, OutputError> {
        check_target(&self.dir, self.replace)?;
        self.lock = None;
        let folder = |source| OutputError::Folder { dir: self.dir.clone(), source };
        fs::remove_file(self.partial.join(LOCK_FILE)).map_err(folder)?;
        let replaces = self.dir.exists();
        if replaces {
            fs::rename(&self.dir, &self.replaced).map_err(folder)?;
        }
        if let Err(source) = fs::rename(&self.partial, &self.dir) {
            if replaces {
                fs::rename(&self.replaced, &self.dir).map_err(folder)?;
            }
            return Err(folder(source));
        }
        self.owned = false;
        self.made.clear();
        if replaces {
            fs::remove_dir_all(&self.replaced).map_err(|source| OutputError::NotRemoved {
                dir: self.dir.clone(),
                replaced: self.replaced.clone(),
                source,
            })?;
        }
        Ok(self.dir.clone())
    }

    fn make_parents(&mut self) -> Result<(), OutputError> {
        let absent = |folder: &&Path| !folder.as_os_str().is_empty() && !folder.exists();
        let absent: Vec<_> =
            self.dir.ancestors().skip(1).take_while(absent).map(Path::to_owned).collect();
        for folder in absent.into_iter().rev() {
            match fs::create_dir(&folder) {
                Ok(()) => self.made.insert(0, folder),
                // Another run made it meanwhile.
                Err(error) if error.kind() == io::ErrorKind::AlreadyExists && folder.is_dir() => {}
                Err(source) => return Err(OutputError::Folder { dir: self.dir.clone(), source }),
            }
        }
        Ok(())
    }

    /// Makes the partial folder and locks it; a killed run's is cleared first.
    fn make_partial(&mut self) -> Result<(), OutputError> {
        let folder = |source| OutputError::Folder { dir: self.partial.clone(), source };
        match fs::create_dir(&self.partial) {
            Ok(()) => {}
            Err(error) if error.kind() == io::ErrorKind::AlreadyExists => {
                let lock = File::options()
                    .create(true)
                    .append(true)
                    .open(self.partial.join(LOCK_FILE))
                    .map_err(folder)?;
                // Where locks are not supported nobody can tell, and nothing is removed.
                if lock.try_lock().is_err() {
                    return Err(OutputError::Busy { partial: self.partial.clone() });
                }
                fs::remove_dir_all(&self.partial).map_err(folder)?;
                fs::create_dir(&self.partial).map_err(folder)?;
            }
            Err(source) => return Err(folder(source)),
        }
        self.owned = true;
        let lock = File::create(self.partial.join(LOCK_FILE)).map_err(folder)?;
        match lock.try_lock() {
            Err(TryLockError::WouldBlock) => {
                // Another run came between the two steps and took the folder over.
                self.owned = false;
                Err(OutputError::Busy { partial: self.partial.clone() })
            }
            Ok(()) | Err(TryLockError::Error(_)) => {
                self.lock = Some(lock);
                Ok(())
            }
        }
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        self.lock = None;
        if self.owned {
            // An error on the way out would hide the one that led here.
            let _ = fs::remove_dir_all(&self.partial);
        }
        // Innermost first, as far as nobody else uses them.
        for folder in &self.made {
            if fs::remove_dir(folder).is_err() {
                break;
            }
        }
    }
}

/// A file of a run while it is written.
///
/// What is buffered reaches the disk only by [`OutputFile::finish`].
#[derive(Debug)]
#[must_use = "a file is complete only after `finish`"]
pub struct OutputFile {
    writer: BufWriter<File>,
    path: PathBuf,
}

impl OutputFile {
    /// Writes what is buffered and waits until it is on disk: a file system may accept a write and
    /// find the quota exceeded only later.
    ///
    /// # Errors
    /// The disk is full, or the file cannot be written for another reason.
    pub fn finish(mut self) -> Result<(), OutputError> {
        let result = self.writer.flush().and_then(|()| self.writer.get_ref().sync_all());
        result.map_err(|source| OutputError::Write { path: self.path, source })
    }
}

impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.flush()
    }
}

/// Whether a run may take the name `dir`.
fn check_target(dir: &Path, replace: bool) -> Result<(), OutputError> {
    let dir = dir.to_owned();
    match fs::symlink_metadata(&dir) {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(()),
        Err(source) => Err(OutputError::Folder { dir, source }),
        Ok(found) if !found.is_dir() => Err(OutputError::IsFile { dir }),
        Ok(_) if !replace => Err(OutputError::Exists { dir }),
        Ok(_) if dir.join(RUN_FILE).is_file() || is_empty(&dir) => Ok(()),
        Ok(_) => Err(OutputError::NotARun { dir }),
    }
}

fn is_empty(dir: &Path) -> bool {
    fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_none())
}

/// `dir` with `suffix` at the end of its name: on the same disk, so that a rename is one step.
pub fn beside(dir: &Path, suffix: &str) -> PathBuf {
    let mut name = dir.file_name().map_or_else(OsString::new, OsString::from);
    name.push(suffix);
    dir.with_file_name(name)
}

/// A file, whole or not at all: written under another name beside it, and renamed. Makes the folder.
///
/// # Errors
/// The folder cannot be made, or the file cannot be written.
pub fn write_whole(path: &Path, bytes: &[u8]) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let partial = beside(path, ".partial");
    let result = fs::write(&partial, bytes).and_then(|()| fs::rename(&partial, path));
    if result.is_err() {
        let _ = fs::remove_file(&partial);
    }
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    fn run_in(dir: &Path, replace: bool, text: &str) -> Result<PathBuf, OutputError> {
        let output = Output::create(dir, replace)?;
        output.write(RUN_FILE, |file| file.write_all(text.as_bytes()))?;
        output.commit()
    }

    fn names(dir: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(dir)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn a_run_appears_whole_and_only_when_committed() {
        let base = tempfile::tempdir().unwrap();
        let dir = base.path().join("a/b/run");
        let output = Output::create(&dir, false).unwrap();
        output.write("bins.csv", |file| writeln!(file, "x")).unwrap();
        assert!(!dir.exists());
        assert_eq!(output.commit().unwrap(), dir);
        assert_eq!(names(&dir), ["bins.csv"]);
        assert_eq!(names(dir.parent().unwrap()), ["run"]);
    }

    #[test]
    fn a_dropped_run_leaves_nothing_not_even_the_parents_it_made() {
        let base = tempfile::tempdir().unwrap();
        let output = Output::create(&base.path().join("a/b/run"), false).unwrap();
        output.write("bins.csv", |file| writeln!(file, "x")).unwrap();
        drop(output);
        assert_eq!(names(base.path()), [""; 0]);

        fs::create_dir(base.path().join("a")).unwrap();
        drop(Output::create(&base.path().join("a/b/run"), false).unwrap());
        assert_eq!(names(base.path()), ["a"]);
        assert_eq!(names(&base.path().join("a")), [""; 0]);
    }

    #[test]
    fn an_earlier_run_is_replaced_at_the_end_and_only_by_force() {
        let base = tempfile::tempdir().unwrap();
        let dir = base.path().join("run");
        run_in(&dir, false, "one").unwrap();
        assert!(matches!(run_in(&dir, false, "two"), Err(OutputError::Exists { .. })));
        let read = || fs::read_to_string(dir.join(RUN_FILE)).unwrap();

        let output = Output::create(&dir, true).unwrap();
        output.write(RUN_FILE, |file| file.write_all(b"two")).unwrap();
        assert_eq!(read(), "one");
        drop(output);
        assert_eq!(read(), "one");

        run_in(&dir, true, "three").unwrap();
        assert_eq!(read(), "three");
        assert_eq!(names(base.path()), ["run"]);
    }

    #[test]
    fn force_does_not_replace_what_is_no_run() {
        let base = tempfile::tempdir().unwrap();
        fs::write(base.path().join("thesis.tex"), "years of work").unwrap();
        let refused = run_in(base.path(), true, "x");
        assert!(matches!(refused, Err(OutputError::NotARun { .. })), "{refused:?}");
        let refused = run_in(&base.path().join("thesis.tex"), true, "x");
        assert!(matches!(refused, Err(OutputError::IsFile { .. })), "{refused:?}");
        assert_eq!(names(base.path()), ["thesis.tex"]);
        assert!(matches!(run_in(Path::new(".."), true, "x"), Err(OutputError::NoName { .. })));

        fs::create_dir(base.path().join("empty")).unwrap();
        run_in(&base.path().join("empty"), true, "x").unwrap();
    }

    #[test]
    fn two_runs_do_not_share_a_folder_and_a_killed_one_does_not_block_the_next() {
        let base = tempfile::tempdir().unwrap();
        let dir = base.path().join("run");
        let live = Output::create(&dir, false).unwrap();
        live.write("mine", |file| file.write_all(b"x")).unwrap();
        assert!(matches!(Output::create(&dir, false), Err(OutputError::Busy { .. })));
        live.write("mine too", |file| file.write_all(b"x")).unwrap();
        live.commit().unwrap();
        assert_eq!(names(&dir), ["mine", "mine too"]);

        let other = base.path().join("other");
        fs::create_dir(base.path().join("other.partial")).unwrap();
        fs::write(base.path().join("other.partial/half"), "of a killed run").unwrap();
        run_in(&other, false, "x").unwrap();
        assert_eq!(names(&other), [RUN_FILE]);
    }

    #[test]
    fn a_name_taken_meanwhile_is_not_overwritten() {
        let base = tempfile::tempdir().unwrap();
        let dir = base.path().join("run");
        let output = Output::create(&dir, false).unwrap();
        fs::create_dir(&dir).unwrap();
        assert!(matches!(output.commit(), Err(OutputError::Exists { .. })));
        assert_eq!(names(base.path()), ["run"]);
    }

    #[test]
    fn an_earlier_run_set_aside_is_not_lost() {
        let base = tempfile::tempdir().unwrap();
        fs::create_dir(base.path().join("run.replaced")).unwrap();
        let refused = run_in(&base.path().join("run"), true, "x");
        assert!(matches!(refused, Err(OutputError::SetAside { .. })));
        assert_eq!(names(base.path()), ["run.replaced"]);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_full_disk_is_reported_with_the_file_and_the_cause() {
        let base = tempfile::tempdir().unwrap();
        let output = Output::create(&base.path().join("run"), false).unwrap();
        std::os::unix::fs::symlink("/dev/full", output.partial().join("bins.csv")).unwrap();
        // Small enough to stay in the buffer until `finish`.
        let late = output.write("bins.csv", |file| file.write_all(b"x")).unwrap_err();
        // Large enough to reach the disk at once.
        let early = output.write("bins.csv", |file| file.write_all(&[0; 100_000])).unwrap_err();
        for error in [late, early] {
            let OutputError::Write { path, source } = error else { panic!("{error:?}") };
            assert_eq!(path, base.path().join("run/bins.csv"));
            assert_eq!(source.kind(), io::ErrorKind::StorageFull);
        }
        drop(output);
        assert_eq!(names(base.path()), [""; 0]);
    }
}
