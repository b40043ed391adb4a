"""Files: what enters is checked before it is used, what leaves is written whole or not at all."""

from remind_jax.files.reading import as_path as as_path
from remind_jax.files.reading import check_name as check_name
from remind_jax.files.reading import check_regular as check_regular
from remind_jax.files.reading import read_bytes as read_bytes
from remind_jax.files.reading import read_text as read_text
from remind_jax.files.reading import reading as reading
from remind_jax.files.reading import say_no_file as say_no_file
from remind_jax.files.saving import LOCK_NAME as LOCK_NAME
from remind_jax.files.saving import append_durably as append_durably
from remind_jax.files.saving import check_place as check_place
from remind_jax.files.saving import locked as locked
from remind_jax.files.saving import make_folder as make_folder
from remind_jax.files.saving import refuse_file as refuse_file
from remind_jax.files.saving import refuse_folder as refuse_folder
from remind_jax.files.saving import remove_unfinished as remove_unfinished
from remind_jax.files.saving import replace_file as replace_file
from remind_jax.files.saving import replacing as replacing
from remind_jax.files.saving import replacing_folder as replacing_folder
from remind_jax.files.saving import resolve as resolve
from remind_jax.files.saving import user_cache_folder as user_cache_folder
from remind_jax.files.saving import writing as writing
