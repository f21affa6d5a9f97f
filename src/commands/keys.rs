//! `keys`: makes, lists and revokes the API keys of a server's data folder, also while the server runs.

use photoneye_server::access::Role;
use photoneye_server::access::keys::{self, KeyError, Stored};
use serde_json::json;

use super::Context;
use crate::cli_access::{KeysArgs, KeysCommand};
use crate::failure::{Failure, plain};
use crate::output;

/// Runs the command.
pub async fn run(context: Context, args: KeysArgs) -> Result<(), Failure> {
    let data = context.settings.data(args.data)?;
    std::fs::create_dir_all(&data)
        .map_err(|error| Failure::failed(format!("cannot make {}: {}", data.display(), plain(&error))))?;
    match args.what {
        KeysCommand::Create { role, tenant, name } => {
            let (id, key) = keys::create(&data, &tenant, &role, &name).await.map_err(failure)?;
            if context.json {
                return output::json_line(
                    &json!({"id": id, "key": key, "tenant": tenant, "roles": words(&role)}),
                );
            }
            output::note(format_args!("key {id} of tenant {tenant}; it is not shown again"));
            output::line(format_args!("{key}"))
        }
        KeysCommand::List => {
            let list = keys::list(&data).await.map_err(failure)?;
            list.iter().try_for_each(|key| show(context.json, key))
        }
        KeysCommand::Revoke { id } => {
            keys::revoke(&data, &id).await.map_err(failure)?;
            output::line(format_args!("{id} revoked"))
        }
    }
}

fn show(json: bool, key: &Stored) -> Result<(), Failure> {
    if json {
        return output::json_line(
            &json!({"id": key.id, "tenant": key.tenant, "roles": words(&key.roles), "name": key.name,
            "created_unix_s": key.created_ms as f64 / 1e3, "revoked_unix_s": key.revoked_ms.map(|ms| ms as f64 / 1e3)}),
        );
    }
    let state = if key.revoked_ms.is_some() { "revoked" } else { "valid" };
    let roles = words(&key.roles).join(",");
    output::line(format_args!("{}  {state:<7}  {:<12}  {roles:<24}  {}", key.id, key.tenant, key.name))
}

fn words(roles: &[Role]) -> Vec<&'static str> {
    roles.iter().map(|role| role.name()).collect()
}

fn failure(error: KeyError) -> Failure {
    match error {
        KeyError::Wrong(message) => Failure::usage(message),
        KeyError::Store(error) => Failure::failed(error),
    }
}
