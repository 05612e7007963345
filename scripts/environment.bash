# The Python environments of scripts/setup and scripts/install-car: which interpreter, which pip, and what is said when
# a step fails. Sourced, in the checkout's folder.

# pip is brought along: what an interpreter brings may be years old, or none. What builds is named by each pyproject.toml.
PIP="pip>=24.1,<27"

# The oldest, and one more than the newest: pyproject.toml alone says it.
read -r python_low python_high < <(sed -nE 's/^requires-python = ">=3\.([0-9]+),<3\.([0-9]+)"$/\1 \2/p' pyproject.toml)
PYTHONS="3.$python_low to 3.$((python_high - 1))"

# python_fits PYTHON: is its version one of these?
python_fits() {
  "$1" -c "import sys; sys.exit(not (3, $python_low) <= sys.version_info[:2] < (3, $python_high))" 2>/dev/null
}

# find_python [PYTHON]: prints the interpreter to be used; this one or none, or the first that fits, the system's own
# before others: its packages for building are to be had.
find_python() {
  local candidate candidates=(${1:+"$1"}) minor
  if (($# == 0)) || [[ ! $1 ]]; then
    candidates=(python3)
    for ((minor = python_low; minor < python_high; minor++)); do
      candidates+=("python3.$minor")
    done
  fi
  for candidate in "${candidates[@]}"; do
    if python_fits "$candidate"; then
      # Not that of an environment which happens to be active: it may be the very one to be made.
      "$candidate" -c 'import sys; print(sys._base_executable)'
      return
    fi
  done
  return 1
}

# every_python: prints the interpreters of this machine that fit, one of each version, oldest first.
every_python() {
  local minor candidate
  for ((minor = python_low; minor < python_high; minor++)); do
    for candidate in "python3.$minor" {"${PYENV_ROOT:-$HOME/.pyenv}"/versions,~/.local/share/uv/python}/*3."$minor".*/bin/python3."$minor"; do
      if python_fits "$candidate"; then
        command -v "$candidate"
        break
      fi
    done
  done
}

# ---- a step that fails ----------------------------------------------------------------------------------------------
# $scratch is a folder of the script that sources this.

# run WORDS...: a command that is named should it fail.
run() {
  printf '%s\n' "$*" >"$scratch/command"
  "$@"
}

# attempt WORDS...: run a function up to its first command that fails; its output goes to the log, its exit status to
# $status. Never a condition itself: within one a shell goes on after an error.
attempt() {
  : >"$scratch/command"
  set +e
  (
    set -e
    "$@"
  ) >"$scratch/log" 2>&1
  status=$?
  set -e
}

# Lines of the log which say what is wrong, with what follows each; if none does, the last ones.
lines_that_matter() {
  local noise='DEPRECATION|Deprecat(ed|ion)|^ *WARNING: (Retrying|Location|Running pip|There was an error checking)|\[notice\]|^W: |^ *$'
  local telling='error|fatal|cannot|could not|unable|denied|no space|not found|no such|failed|killed|not able|missing'
  grep -vE "$noise" "$scratch/log" >"$scratch/lines" || true
  if grep -qiE "$telling" "$scratch/lines"; then
    grep -iE -A 4 "$telling" "$scratch/lines" | grep -vx -- -- | tail -n 16 | cut -c 1-300
  else
    tail -n 16 "$scratch/lines" | cut -c 1-300
  fi
}

# What to do: by what the log says.
advice() {
  local log=$scratch/log
  if grep -qiE 'no space left on device|disk quota exceeded|ENOSPC' "$log"; then
    echo "the disk is full (df -h . /tmp): make room, 2 GB"
  elif grep -qE 'NewConnectionError|NameResolutionError|Connect(ion|)Timeout|ReadTimeout|ProxyError|ConnectionRefused' "$log"; then
    echo "no connection to the Python package index: look at network and proxy (https_proxy)"
  elif grep -qE 'CERTIFICATE_VERIFY_FAILED|SSLError' "$log"; then
    echo "the package index shows a certificate that this machine does not know: install ca-certificates, look at the clock (date), or name your network's certificate (PIP_CERT=FILE)"
  elif grep -qE 'Temporary failure resolving|Could not (resolve|connect)|Failed to fetch|Unable to connect' "$log"; then
    echo "no connection to the distribution's packages: look at network and proxy (/etc/apt)"
  elif grep -qE 'Unable to locate package|has no installation candidate' "$log"; then
    echo "the distribution's lists lack a package: apt-get update, and look at /etc/apt for what is missing (Ubuntu: universe)"
  elif grep -qE 'Could not get lock|dpkg was interrupted' "$log"; then
    echo "apt is at work already, or was interrupted: wait for it, or: dpkg --configure -a"
  elif grep -qiE 'permission denied|EACCES' "$log"; then
    echo "files here are another user's, perhaps from a run as root: sudo chown -R $(id -un) ."
  elif grep -qE 'compiler identification is unknown|not able to compile a simple test|CMAKE_C(XX)?_COMPILER|command .*(cc|c\+\+|gcc|g\+\+).* failed|internal compiler error|Python\.h' "$log"; then
    echo "the compiler does not work: sudo apt-get install -y --reinstall gcc g++ libc6-dev python3-dev; then look at: which cc c++"
  elif grep -qE 'Killed|MemoryError|[Cc]annot allocate memory' "$log"; then
    echo "memory was short: end other programs"
  elif grep -qE 'No matching distribution found' "$log"; then
    echo "the index has no such package for this Python and processor: another Python may be chosen, PYTHON=/path/to/python3.X"
  else
    echo "the lines above say what is wrong"
  fi
}

# failed WHO WHAT: say what failed, in which command, the lines that matter, and what to do; and end.
failed() {
  local command
  command=$(sed "s#$PWD/##g" "$scratch/command")
  {
    printf '%s: failed: %s\n' "$1" "$2"
    [[ ! $command ]] || printf '%s: the command:  %s\n' "$1" "$command"
    lines_that_matter | sed 's/^/    /'
    if mkdir -p out && cp "$scratch/log" "out/$1.log"; then
      printf '%s: all that it said: out/%s.log\n' "$1" "$1"
    fi 2>/dev/null
    printf '%s: %s. Then run the same again: it goes on where it was.\n' "$1" "$(advice)"
  } >&2
  exit 1
}
